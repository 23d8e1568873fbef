//! Eight numbers at a time.
//!
//! One kernel, compiled twice: for any machine, with arrays that the compiler spreads over the registers there are, and for x86-64 with
//! AVX2 and FMA, chosen when the program runs. Products may be fused or not, so two machines may differ in the last place: what is
//! computed here may only be used with a margin.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::__m256;

#[cfg(target_arch = "x86_64")]
use pulp::NullaryFnOnce;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;

/// How many numbers are handled at once.
pub(super) const LANES: usize = 8;

/// One number for each lane.
pub(super) type Row = [f32; LANES];

/// Arithmetic on eight lanes. Comparisons return one bit per lane, lane 0 lowest, and are false for NaN.
pub(super) trait Lanes: Copy {
    /// Eight numbers.
    type Floats: Copy;

    fn load(self, row: &Row) -> Self::Floats;
    fn splat(self, value: f32) -> Self::Floats;
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn sub(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// `a b + c`, perhaps fused.
    fn mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// `a b - c`, perhaps fused.
    fn mul_sub(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// `c - a b`, perhaps fused.
    fn neg_mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// The smaller; of NaN and a number either may come out.
    fn min(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// The larger; of NaN and a number either may come out.
    fn max(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// `a` where `b` has no minus sign, else `-a`.
    fn signed_by(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn less(self, a: Self::Floats, b: Self::Floats) -> u32;
    fn to_row(self, a: Self::Floats) -> Row;

    #[inline(always)]
    fn abs(self, a: Self::Floats) -> Self::Floats {
        self.signed_by(a, a)
    }
}

/// Something to do with eight lanes.
pub(super) trait Kernel {
    type Output;

    /// Must be `#[inline(always)]`, and all that it calls in its inner loops, to be compiled for the lanes it is given.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Which machine's instructions are used.
#[derive(Clone, Copy, Debug)]
pub(super) enum Machine {
    /// Those that every machine of this kind has.
    Any,
    #[cfg(target_arch = "x86_64")]
    Avx2(V3),
}

impl Machine {
    /// The best that is there.
    pub(super) fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(instructions) = V3::try_new() {
            return Self::Avx2(instructions);
        }
        Self::Any
    }

    #[inline]
    pub(super) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Self::Any => kernel.run(Arrays),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(instructions) => instructions.vectorize(WithAvx2 {
                kernel,
                instructions,
            }),
        }
    }
}

#[cfg(target_arch = "x86_64")]
struct WithAvx2<K> {
    kernel: K,
    instructions: V3,
}

#[cfg(target_arch = "x86_64")]
impl<K: Kernel> NullaryFnOnce for WithAvx2<K> {
    type Output = K::Output;

    #[inline(always)]
    fn call(self) -> K::Output {
        self.kernel.run(self.instructions)
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for V3 {
    type Floats = __m256;

    #[inline(always)]
    fn load(self, row: &Row) -> __m256 {
        pulp::cast(*row)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> __m256 {
        self.avx._mm256_set1_ps(value)
    }

    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_add_ps(a, b)
    }

    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_sub_ps(a, b)
    }

    #[inline(always)]
    fn mul(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_mul_ps(a, b)
    }

    #[inline(always)]
    fn mul_add(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        self.fma._mm256_fmadd_ps(a, b, c)
    }

    #[inline(always)]
    fn mul_sub(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        self.fma._mm256_fmsub_ps(a, b, c)
    }

    #[inline(always)]
    fn neg_mul_add(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        self.fma._mm256_fnmadd_ps(a, b, c)
    }

    #[inline(always)]
    fn min(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_min_ps(a, b)
    }

    #[inline(always)]
    fn max(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_max_ps(a, b)
    }

    #[inline(always)]
    fn signed_by(self, a: __m256, b: __m256) -> __m256 {
        let sign = self.avx._mm256_and_ps(b, self.splat(-0.0));
        self.avx._mm256_xor_ps(a, sign)
    }

    #[inline(always)]
    fn less(self, a: __m256, b: __m256) -> u32 {
        const LESS_ORDERED_QUIET: i32 = 17;
        let mask = self.avx._mm256_cmp_ps::<LESS_ORDERED_QUIET>(a, b);
        self.avx._mm256_movemask_ps(mask) as u32
    }

    #[inline(always)]
    fn to_row(self, a: __m256) -> Row {
        pulp::cast(a)
    }
}

/// Lanes as arrays.
#[derive(Clone, Copy, Debug)]
struct Arrays;

#[inline(always)]
fn each(f: impl Fn(usize) -> f32) -> Row {
    let mut row = [0.0; LANES];
    for (lane, value) in row.iter_mut().enumerate() {
        *value = f(lane);
    }
    row
}

impl Lanes for Arrays {
    type Floats = Row;

    #[inline(always)]
    fn load(self, row: &Row) -> Row {
        *row
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Row {
        [value; LANES]
    }

    #[inline(always)]
    fn add(self, a: Row, b: Row) -> Row {
        each(|i| a[i] + b[i])
    }

    #[inline(always)]
    fn sub(self, a: Row, b: Row) -> Row {
        each(|i| a[i] - b[i])
    }

    #[inline(always)]
    fn mul(self, a: Row, b: Row) -> Row {
        each(|i| a[i] * b[i])
    }

    #[inline(always)]
    fn mul_add(self, a: Row, b: Row, c: Row) -> Row {
        each(|i| a[i] * b[i] + c[i])
    }

    #[inline(always)]
    fn mul_sub(self, a: Row, b: Row, c: Row) -> Row {
        each(|i| a[i] * b[i] - c[i])
    }

    #[inline(always)]
    fn neg_mul_add(self, a: Row, b: Row, c: Row) -> Row {
        each(|i| c[i] - a[i] * b[i])
    }

    #[inline(always)]
    fn min(self, a: Row, b: Row) -> Row {
        each(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    fn max(self, a: Row, b: Row) -> Row {
        each(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    fn signed_by(self, a: Row, b: Row) -> Row {
        each(|i| f32::from_bits(a[i].to_bits() ^ (b[i].to_bits() & (1 << 31))))
    }

    #[inline(always)]
    fn less(self, a: Row, b: Row) -> u32 {
        (0..LANES).fold(0, |mask, i| mask | u32::from(a[i] < b[i]) << i)
    }

    #[inline(always)]
    fn to_row(self, a: Row) -> Row {
        a
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_of_lanes_compute_the_same() {
        let Machine::Avx2(avx2) = Machine::best() else {
            return;
        };
        let a = [1.5, -0.0, 0.0, f32::NAN, -3.25, 1e-40, 7.0, f32::INFINITY];
        let b = [2.5, 0.0, -0.0, 1.0, -3.5, -1e-40, 7.0, 1.0];
        let c = [0.25, -1.0, 2.0, 1.0, 8.0, 1.0, -49.0, 1.0];
        let bits = |row: Row| {
            row.map(|value| {
                if value.is_nan() {
                    u32::MAX
                } else {
                    value.to_bits()
                }
            })
        };
        let [x, y, z] = [a, b, c].map(|row| avx2.load(&row));
        let same = |got: __m256, want: Row| assert_eq!(bits(avx2.to_row(got)), bits(want));
        same(avx2.add(x, y), Arrays.add(a, b));
        same(avx2.sub(x, y), Arrays.sub(a, b));
        same(avx2.mul(x, y), Arrays.mul(a, b));
        same(avx2.min(x, y), Arrays.min(a, b));
        same(avx2.max(x, y), Arrays.max(a, b));
        same(avx2.abs(x), Arrays.abs(a));
        same(avx2.signed_by(x, y), Arrays.signed_by(a, b));
        same(avx2.splat(-0.0), Arrays.splat(-0.0));
        // These products are exact, so that fusing changes nothing.
        same(avx2.mul_add(x, y, z), Arrays.mul_add(a, b, c));
        same(avx2.mul_sub(x, y, z), Arrays.mul_sub(a, b, c));
        same(avx2.neg_mul_add(x, y, z), Arrays.neg_mul_add(a, b, c));
        assert_eq!(avx2.less(x, y), Arrays.less(a, b));
        assert_eq!(avx2.less(y, x), Arrays.less(b, a));
    }
}
