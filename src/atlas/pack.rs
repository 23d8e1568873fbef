//! Packs the rectangles of all instances into pages.
//!
//! Guillotine packing of rectangles sorted by height (the crate guillotiere, made for texture atlases). The last page, which for most
//! scenes is the only one, gets the smallest size on a ladder of squares that holds the rest, and every page is trimmed to what is used.

use guillotiere::{AllocatorOptions, AtlasAllocator, size2};

use crate::error::{Error, Result};

use super::{Page, Placement};

/// A rectangle to place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    /// Index in the scene's instances.
    pub(super) instance: usize,
    /// Index in the atlas's unwraps.
    pub(super) unwrap: usize,
    /// Width and height in texels.
    pub(super) size: [u32; 2],
    /// Texels to keep free on each side.
    pub(super) margin: u32,
}

impl Block {
    /// Width (0) or height (1) with what is kept free.
    pub(super) fn side(&self, axis: usize) -> u32 {
        self.size[axis] + 2 * self.margin
    }
}

/// Pages of a bake. An engine that needs thousands of lightmap textures has no use for them, and each costs several files.
const MAX_PAGES: usize = 1024;

/// Places all blocks, none of which is larger than `page`, a multiple of 4.
///
/// Placements are ordered by page, row, column; the same blocks give the same pages.
///
/// # Errors
/// `TooLarge` when there would be more than [`MAX_PAGES`] pages.
pub(super) fn pack(mut blocks: Vec<Block>, page: u32) -> Result<(Vec<Placement>, Vec<Page>)> {
    blocks.sort_by_key(|block| {
        let descending = |axis| std::cmp::Reverse(block.side(axis));
        (descending(1), descending(0), block.instance, block.unwrap)
    });
    let mut placements = Vec::with_capacity(blocks.len());
    let mut pages = Vec::new();
    while !blocks.is_empty() {
        if pages.len() == MAX_PAGES {
            return Err(Error::TooLarge {
                reason: format!(
                    "the surfaces need more than {MAX_PAGES} pages of {page}² texels; raise --page or lower --texels-per-metre"
                ),
            });
        }
        let offsets = fill_smallest(&blocks, page);
        let mut used = [0; 2];
        let mut left = Vec::new();
        for (block, offset) in blocks.iter().zip(offsets) {
            let Some(offset) = offset else {
                left.push(*block);
                continue;
            };
            for axis in 0..2 {
                used[axis] = used[axis].max(offset[axis] + block.side(axis));
            }
            placements.push(Placement {
                instance: block.instance,
                unwrap: block.unwrap,
                page: pages.len(),
                offset: offset.map(|corner| corner + block.margin),
            });
        }
        debug_assert!(left.len() < blocks.len(), "an empty page holds any block");
        let [width, height] = used.map(|side| side.next_multiple_of(4));
        pages.push(Page { width, height });
        blocks = left;
    }
    placements.sort_by_key(|placement| (placement.page, placement.offset[1], placement.offset[0]));
    Ok((placements, pages))
}

/// Offsets on the smallest page that holds all blocks; if none does, on a full page those of the blocks that fit, in order.
fn fill_smallest(blocks: &[Block], page: u32) -> Vec<Option<[u32; 2]>> {
    /// Growth of the side per step. Finer steps save less than 2 % of a page and cost as many more trials.
    const STEP: f64 = 1.02;
    let area: f64 = blocks
        .iter()
        .map(|block| f64::from(block.side(0)) * f64::from(block.side(1)))
        .sum();
    let longest = blocks
        .iter()
        .map(|block| block.side(0).max(block.side(1)))
        .max()
        .unwrap_or(0);
    let mut side = area.sqrt().max(f64::from(longest));
    while side < f64::from(page) {
        let offsets = fill(blocks, (side.ceil() as u32).next_multiple_of(4), true);
        if offsets.len() == blocks.len() {
            return offsets;
        }
        side *= STEP;
    }
    fill(blocks, page, false)
}

/// Offsets of blocks, in order, on a page of `side`² texels. With `all_or_nothing` it stops at the first that does not fit.
fn fill(blocks: &[Block], side: u32, all_or_nothing: bool) -> Vec<Option<[u32; 2]>> {
    let side = side as i32;
    let mut allocator =
        AtlasAllocator::with_options(size2(side, side), &AllocatorOptions::default());
    let mut offsets = Vec::with_capacity(blocks.len());
    for block in blocks {
        let allocation = allocator.allocate(size2(block.side(0) as i32, block.side(1) as i32));
        if allocation.is_none() && all_or_nothing {
            break;
        }
        offsets.push(allocation.map(|allocation| {
            let corner = allocation.rectangle.min;
            [corner.x as u32, corner.y as u32]
        }));
    }
    offsets
}
