//! Random numbers without a generator: a hash of what they are for.
//!
//! A number depends only on its key, never on which thread drew it or how many were drawn before, so results do not change with
//! the number of threads. The mixer is the finaliser of `SplitMix64` (Steele, Lea and Flood, "Fast splittable pseudorandom number
//! generators", OOPSLA 2014).

/// Well-mixed 64 bits of the key `(a, b, c)`, for example (texel, light, index).
#[must_use]
pub fn hash(a: u64, b: u64, c: u64) -> u64 {
    mix(mix(mix(a).wrapping_add(b)).wrapping_add(c))
}

/// Two independent uniform numbers in [0, 1) from 64 well-mixed bits.
#[must_use]
pub fn unit_pair(bits: u64) -> [f64; 2] {
    const SCALE: f64 = 1.0 / 4_294_967_296.0;
    [
        f64::from((bits >> 32) as u32) * SCALE,
        f64::from(bits as u32) * SCALE,
    ]
}

fn mix(key: u64) -> u64 {
    let mut z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_keys_give_uniform_numbers() {
        let n = 1 << 14;
        let mut mean = [0.0; 2];
        let mut product = 0.0;
        for index in 0..n {
            let [u, v] = unit_pair(hash(7, 0, index));
            assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
            mean[0] += u;
            mean[1] += v;
            product += (u - 0.5) * (v - 0.5);
        }
        // Standard error of a mean of n uniform numbers is 0.29/√n = 0.0023; five of them.
        for sum in mean {
            assert!(
                (sum / n as f64 - 0.5).abs() < 0.0115,
                "mean {}",
                sum / n as f64
            );
        }
        assert!((product / n as f64).abs() < 0.0033, "correlated");
    }
}
