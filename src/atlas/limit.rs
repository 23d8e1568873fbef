//! Refuses scenes that need more texels than a bake can hold, before and after the layout is known.

use crate::error::{Error, Result};

use super::Options;
use super::group::Group;
use super::pack::Block;

/// Texels of all pages together. A covered texel takes about 130 bytes while its page is baked and 60 in its maps; 2^28 is the
/// equivalent of 64 pages of 2048², more than an engine would load. A larger limit turns a wrong unit into a day of waiting, a smaller one
/// refuses large levels that fit.
const MAX_TEXELS: f64 = (1u64 << 28) as f64;

/// Part of a page that surfaces cover when all goes well; what is known before the layout is the surfaces alone.
const USUAL_UTILISATION: f64 = 0.7;

/// Refuses surfaces that cannot fit however well they are packed.
///
/// # Errors
/// `TooLarge`.
pub(super) fn check_area(groups: &[Group], options: &Options) -> Result<()> {
    let texels: f64 = groups
        .iter()
        .map(|group| group.area * group.instances.len() as f64)
        .sum();
    if texels <= MAX_TEXELS {
        return Ok(());
    }
    Err(too_large(texels, options))
}

/// Refuses rectangles that need too much once borders and padding are known.
///
/// # Errors
/// `TooLarge`.
pub(super) fn check_blocks(blocks: &[Block], options: &Options) -> Result<()> {
    let texels: f64 = blocks
        .iter()
        .map(|block| block.side(0) as f64 * block.side(1) as f64)
        .sum();
    if texels <= MAX_TEXELS {
        return Ok(());
    }
    Err(too_large(texels, options))
}

fn too_large(texels: f64, options: &Options) -> Error {
    let fits = options.texels_per_metre * (MAX_TEXELS * USUAL_UTILISATION / texels).sqrt();
    let advice = if fits >= 1e-3 {
        format!("--texels-per-metre {} fits", two_digits_down(fits))
    } else {
        "no density fits, check the units of the scene".to_owned()
    };
    Error::TooLarge {
        reason: format!(
            "the surfaces need {texels:.2e} texels at {} texels per metre, the limit is {MAX_TEXELS:.2e}; {advice}",
            options.texels_per_metre
        ),
    }
}

/// `value` rounded down to two significant digits.
fn two_digits_down(value: f64) -> f64 {
    let unit = 10f64.powi(value.log10().floor() as i32 - 1);
    let digits = (value / unit).floor();
    // Division by a power of ten rounds to the nearest decimal; multiplication by 0.001 would not.
    if unit < 1.0 {
        digits / (1.0 / unit).round()
    } else {
        digits * unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_is_short_and_below_the_value() {
        for (value, short) in [
            (8.0, "8"),
            (0.123_4, "0.12"),
            (1234.0, "1200"),
            (0.001_99, "0.0019"),
        ] {
            let rounded = two_digits_down(value);
            assert_eq!(rounded.to_string(), short);
            assert!(rounded <= value);
        }
    }
}
