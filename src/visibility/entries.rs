//! What the builder of the tree is given: triangles with equal boxes (duplicates, the two halves of an axis-parallel rectangle, detail
//! too fine for `f32`) share one entry, because the builder takes quadratic time when thousands of boxes are equal.

use std::ops::Range;

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;

/// Triangles in the order of the leaves, and for each node of `bvh` where its own lie in that order.
pub(super) fn in_order(bvh: &Bvh2, entries: &Entries) -> (Vec<Range<u32>>, Vec<u32>) {
    let mut ids = Vec::with_capacity(entries.ids.len());
    let mut ranges = vec![0..0; bvh.nodes.len()];
    let mut stack = Vec::new();
    if !bvh.nodes.is_empty() {
        stack.push((0, false));
    }
    while let Some((index, done)) = stack.pop() {
        let node = &bvh.nodes[index];
        let first = node.first_index as usize;
        if !done {
            ranges[index].start = ids.len() as u32;
            if node.is_leaf() {
                for &entry in &bvh.primitive_indices[first..first + node.prim_count as usize] {
                    ids.extend_from_slice(entries.triangles(entry));
                }
            } else {
                stack.extend([(index, true), (first + 1, false), (first, false)]);
            }
        }
        ranges[index].end = ids.len() as u32;
    }
    (ranges, ids)
}

/// Leaf entries: distinct boxes and, for each, the triangles that have it.
pub(super) struct Entries {
    pub(super) boxes: Vec<Aabb>,
    /// Where the triangles of each box begin in `ids`; one more than boxes.
    starts: Vec<usize>,
    ids: Vec<u32>,
}

impl Entries {
    /// Groups `ids` by equal boxes, each group ascending.
    pub(super) fn of(ids: &[u32], bounds: impl Fn(u32) -> Aabb) -> Self {
        let key = |id: u32| {
            let bounds = bounds(id);
            [bounds.min.to_array(), bounds.max.to_array()].map(|corner| corner.map(f32::to_bits))
        };
        let mut keyed: Vec<_> = ids.iter().map(|&id| (key(id), id)).collect();
        keyed.sort_unstable();
        let mut entries = Self {
            boxes: Vec::new(),
            starts: Vec::new(),
            ids: keyed.iter().map(|&(_, id)| id).collect(),
        };
        for (index, (key, id)) in keyed.iter().enumerate() {
            if index == 0 || *key != keyed[index - 1].0 {
                entries.boxes.push(bounds(*id));
                entries.starts.push(index);
            }
        }
        entries.starts.push(keyed.len());
        entries
    }

    fn triangles(&self, entry: u32) -> &[u32] {
        let entry = entry as usize;
        &self.ids[self.starts[entry]..self.starts[entry + 1]]
    }
}
