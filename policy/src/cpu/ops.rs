//! Operations between the products: softmax, LayerNorm, sums over rows. They are written over arrays of 16, which the
//! compiler turns into vectors of the machine's width.

use pulp::Arch;

/// Added to the variance in a LayerNorm (Haiku's default).
const EPSILON: f32 = 1e-5;

/// Number of values processed in parallel.
const LANES: usize = 16;

/// Intermediate results of a LayerNorm for its backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct Normalized {
    /// Rows with mean 0 and variance 1, before scale and offset, `[rows, width]`.
    pub(super) hat: Vec<f32>,
    /// 1 / standard deviation of each row, `[rows]`.
    pub(super) inverse_std: Vec<f32>,
}

/// Sums `f` over the entries of two rows, in 16 partial sums.
#[inline(always)]
fn sum_of(a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32) -> f32 {
    let (a_lanes, a_rest) = a.as_chunks::<LANES>();
    let (b_lanes, b_rest) = b.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (a, b) in a_lanes.iter().zip(b_lanes) {
        for i in 0..LANES {
            sums[i] += f(a[i], b[i]);
        }
    }
    fold(sums, |a, b| a + b) + a_rest.iter().zip(b_rest).map(|(a, b)| f(*a, *b)).sum::<f32>()
}

/// Reduces 16 numbers as a tree.
#[inline(always)]
fn fold(mut lanes: [f32; LANES], f: impl Fn(f32, f32) -> f32) -> f32 {
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            lanes[i] = f(lanes[i], lanes[i + half]);
        }
    }
    lanes[0]
}

/// Computes `Σ aᵢ bᵢ`.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    sum_of(a, b, |a, b| a * b)
}

/// Computes eˣ for x ≤ 0, within two units in the last place; below −87 the result stays at e⁻⁸⁷.
///
/// Splits x into n ln 2 + r with |r| ≤ ln 2 / 2. Adding 1.5 · 2²³ rounds to the integer n and leaves it in the low
/// bits.
#[inline(always)]
pub(super) fn exp_of_negative(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    let x = x.max(-87.0);
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN2_HIGH) - n * LN2_LOW;
    // Cephes' polynomial for (eʳ − 1 − r) / r².
    let p = 1.987_569_2e-4;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 0.166_666_66;
    let p = p * r + 0.5;
    let e = p * r * r + r + 1.0;
    f32::from_bits(e.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// Computes the softmax of 16 logits in place; the one at `absent` gets probability 0.
#[inline(always)]
pub(super) fn softmax(row: &mut [f32; LANES], absent: Option<usize>) {
    if let Some(absent) = absent {
        row[absent] = f32::NEG_INFINITY;
    }
    let max = fold(*row, f32::max);
    for x in row.iter_mut() {
        *x = exp_of_negative(*x - max);
    }
    if let Some(absent) = absent {
        row[absent] = 0.0;
    }
    let scale = 1.0 / fold(*row, |a, b| a + b);
    for x in row.iter_mut() {
        *x *= scale;
    }
}

/// Computes the gradient of a softmax's logits from that of its probabilities, in place: `p (g − Σ p g)`.
#[inline(always)]
pub(super) fn softmax_backward(probabilities: &[f32; LANES], gradient: &mut [f32; LANES]) {
    let mut products = *gradient;
    for (product, p) in products.iter_mut().zip(probabilities) {
        *product *= p;
    }
    let mean = fold(products, |a, b| a + b);
    for (g, p) in gradient.iter_mut().zip(probabilities) {
        *g = p * (*g - mean);
    }
}

/// Computes `y = LayerNorm(a + b)`, adding the rows of a and b.
///
/// # Shapes
/// a, b, y `[rows, width]`, scale and offset `[width]`
pub(super) fn layer_norm(
    arch: Arch,
    [a, b]: [&[f32]; 2],
    [scale, offset]: [&[f32]; 2],
    kept: &mut Normalized,
    y: &mut [f32],
) {
    let width = scale.len();
    kept.hat.resize(a.len(), 0.0);
    kept.inverse_std.resize(a.len() / width, 0.0);
    arch.dispatch(
        #[inline(always)]
        || {
            let rows = a.chunks_exact(width).zip(b.chunks_exact(width));
            let outputs = kept.hat.chunks_exact_mut(width).zip(y.chunks_exact_mut(width)).zip(&mut kept.inverse_std);
            for ((a, b), ((hat, y), inverse_std)) in rows.zip(outputs) {
                for (hat, (a, b)) in hat.iter_mut().zip(a.iter().zip(b)) {
                    *hat = a + b;
                }
                let mean = sum_of(hat, hat, |x, _| x) / width as f32;
                let variance = sum_of(hat, hat, |x, _| (x - mean) * (x - mean)) / width as f32;
                *inverse_std = 1.0 / (variance + EPSILON).sqrt();
                for ((hat, y), (scale, offset)) in hat.iter_mut().zip(y).zip(scale.iter().zip(offset)) {
                    *hat = (*hat - mean) * *inverse_std;
                    *y = *hat * scale + offset;
                }
            }
        },
    );
}

/// Computes the gradient of a LayerNorm's input from that of its output, in place, and adds the gradients of scale and
/// offset.
///
/// # Shapes
/// gradient `[rows, width]`, all others `[width]`
pub(super) fn layer_norm_backward(
    arch: Arch,
    kept: &Normalized,
    scale: &[f32],
    gradient: &mut [f32],
    [scale_gradient, offset_gradient]: [&mut [f32]; 2],
) {
    let width = scale.len();
    arch.dispatch(
        #[inline(always)]
        || {
            let rows = kept.hat.chunks_exact(width).zip(&kept.inverse_std);
            for (g, (hat, inverse_std)) in gradient.chunks_exact_mut(width).zip(rows) {
                let sums = scale_gradient.iter_mut().zip(offset_gradient.iter_mut());
                for ((g, hat), ((ds, db), scale)) in g.iter_mut().zip(hat).zip(sums.zip(scale)) {
                    *ds += *g * hat;
                    *db += *g;
                    *g *= scale;
                }
                let mean = sum_of(g, hat, |g, _| g) / width as f32;
                let slope = sum_of(g, hat, |g, hat| g * hat) / width as f32;
                for (g, hat) in g.iter_mut().zip(hat) {
                    *g = (*g - mean - hat * slope) * inverse_std;
                }
            }
        },
    );
}

/// Sets the gradient to 0 where the output of a ReLU is 0.
pub(super) fn relu_backward(arch: Arch, output: &[f32], gradient: &mut [f32]) {
    arch.dispatch(
        #[inline(always)]
        || {
            for (g, y) in gradient.iter_mut().zip(output) {
                *g = if *y > 0.0 { *g } else { 0.0 };
            }
        },
    );
}

/// Adds all rows to `to`.
///
/// # Shapes
/// rows `[n, width]`, to `[width]`
pub(super) fn add_rows(arch: Arch, rows: &[f32], to: &mut [f32]) {
    let width = to.len();
    arch.dispatch(
        #[inline(always)]
        || rows.chunks_exact(width).for_each(|row| add_to(row, to)),
    );
}

/// Sums every 16 rows.
///
/// # Shapes
/// rows `[16 n, width]`, to `[n, width]`
pub(super) fn sum_nodes(arch: Arch, rows: &[f32], width: usize, to: &mut [f32]) {
    arch.dispatch(
        #[inline(always)]
        || {
            for (rows, to) in rows.chunks_exact(16 * width).zip(to.chunks_exact_mut(width)) {
                to.fill(0.0);
                rows.chunks_exact(width).for_each(|row| add_to(row, to));
            }
        },
    );
}

/// Adds each row of `to_each` to the rows of its 16 nodes.
///
/// # Shapes
/// rows `[16 n, width]`, to_each `[n, width]`
pub(super) fn add_to_nodes(arch: Arch, to_each: &[f32], width: usize, rows: &mut [f32]) {
    arch.dispatch(
        #[inline(always)]
        || {
            for (rows, row) in rows.chunks_exact_mut(16 * width).zip(to_each.chunks_exact(width)) {
                rows.chunks_exact_mut(width).for_each(|to| add_to(row, to));
            }
        },
    );
}

/// `to += from`.
pub(super) fn add(arch: Arch, from: &[f32], to: &mut [f32]) {
    arch.dispatch(
        #[inline(always)]
        || add_to(from, to),
    );
}

#[inline(always)]
fn add_to(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_within_two_units_in_the_last_place() {
        for i in 0..=87_000 {
            let x = -(i as f32) / 1000.0;
            let found = exp_of_negative(x);
            let exact = f64::from(x).exp();
            assert!((f64::from(found) - exact).abs() <= 2.4e-7 * exact, "{x}: {found} {exact}");
        }
        assert_eq!(exp_of_negative(0.0), 1.0);
        assert!(exp_of_negative(f32::NEG_INFINITY) < 2e-38);
    }

    #[test]
    fn softmax_leaves_out_what_is_absent() {
        let mut row = [0.0; LANES];
        row[3] = 2.0_f32.ln();
        softmax(&mut row, Some(5));
        // The weights are one 2 and fourteen 1s, 16 in total.
        assert!((row[3] - 2.0 / 16.0).abs() < 1e-7 && (row[0] - 1.0 / 16.0).abs() < 1e-7);
        assert_eq!(row[5], 0.0);
    }

    #[test]
    fn layer_norm_by_hand() {
        let arch = Arch::new();
        let mut kept = Normalized::default();
        let mut y = [0.0; 2];
        // 1 + 0 and 2 + 1: mean 2, variance 1.
        layer_norm(arch, [&[1.0, 2.0], &[0.0, 1.0]], [&[2.0, 2.0], &[0.5, 0.5]], &mut kept, &mut y);
        assert!((y[0] + 1.5).abs() < 1e-4 && (y[1] - 2.5).abs() < 1e-4, "{y:?}");
        // With two entries, the output depends only on the sign of the input difference.
        let mut gradient = [1.0, 0.0];
        let (mut ds, mut db) = ([0.0; 2], [0.0; 2]);
        layer_norm_backward(arch, &kept, &[2.0, 2.0], &mut gradient, [&mut ds, &mut db]);
        assert!(gradient.iter().all(|g| g.abs() < 1e-4), "{gradient:?}");
        assert!((ds[0] + 1.0).abs() < 1e-4 && db == [1.0, 0.0]);
    }
}
