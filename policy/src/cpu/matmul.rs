//! Products of row-major matrices in registers: the only code in which a machine's vector width matters.
//!
//! Safe code on top of [`pulp`], compiled for AVX-512, AVX2, NEON, and scalars; uses the first that the machine
//! supports. A tile of the result, of up to 6 rows and 4 vectors, stays in registers while one matrix is read from
//! front to back.

use pulp::{Arch, Simd, WithSimd};

/// Columns of a panel: a whole number of vectors on every machine; 16 rows of a panel fit into the L1 cache.
const PANEL: usize = 64;

/// Number of rows that [`add_transposed`] sums at a time, so that its inputs stay in the cache.
const ROWS: usize = 256;

/// The right-hand matrix of a product, split into contiguous panels of 64 columns.
#[derive(Clone, Debug, Default)]
pub(super) struct Packed {
    k: usize,
    n: usize,
    data: Vec<f32>,
}

/// The values to which a product is added.
#[derive(Clone, Copy)]
pub(super) enum Base<'a> {
    /// Zeros.
    Zero,
    /// The current contents of the result.
    Kept,
    /// The same row for all rows, `[n]`.
    Bias(&'a [f32]),
    /// One row for every 16 rows, `[m / 16, n]`.
    PerGraph(&'a [f32]),
}

impl Packed {
    /// Packs `w`.
    ///
    /// # Shapes
    /// `w` `[k, n]`
    pub(super) fn new(w: &[f32], [k, n]: [usize; 2]) -> Self {
        debug_assert_eq!(w.len(), k * n);
        let mut data = Vec::with_capacity(k * n);
        for first in (0..n).step_by(PANEL) {
            let columns = first..n.min(first + PANEL);
            (0..k).for_each(|row| data.extend_from_slice(&w[row * n..][columns.clone()]));
        }
        Self { k, n, data }
    }

    /// Packs the transpose of `w`.
    ///
    /// # Shapes
    /// `w` `[n, k]`
    pub(super) fn transposed(w: &[f32], [n, k]: [usize; 2]) -> Self {
        debug_assert_eq!(w.len(), k * n);
        let mut data = Vec::with_capacity(k * n);
        for first in (0..n).step_by(PANEL) {
            let columns = first..n.min(first + PANEL);
            (0..k).for_each(|row| data.extend(columns.clone().map(|column| w[column * k + row])));
        }
        Self { k, n, data }
    }
}

/// Computes `c = base + a · w`, followed by a ReLU if `relu` is set.
///
/// # Shapes
/// a `[m, k]`, w `[k, n]`, c `[m, n]`
pub(super) fn product(arch: Arch, a: &[f32], w: &Packed, base: Base<'_>, relu: bool, c: &mut [f32]) {
    debug_assert_eq!(a.len() / w.k.max(1), c.len() / w.n.max(1));
    arch.dispatch(Product { a, k: w.k, n: w.n, panels: &w.data, width: PANEL, base, relu, c });
}

/// Computes `a · w`.
///
/// # Shapes
/// a `[m, k]`, w `[k, n]` → `[m, n]`
pub(super) fn product_of(arch: Arch, a: &[f32], w: &Packed) -> Vec<f32> {
    let mut c = vec![0.0; a.len() / w.k * w.n];
    product(arch, a, w, Base::Zero, false, &mut c);
    c
}

/// Computes `a · b` of plain matrices.
///
/// # Shapes
/// a `[m, k]`, b `[k, n]` → `[m, n]`
pub(super) fn multiply(arch: Arch, a: &[f32], b: &[f32], k: usize) -> Vec<f32> {
    product_of(arch, a, &Packed::new(b, [k, b.len() / k]))
}

/// Computes `a · bᵀ` of plain matrices.
///
/// # Shapes
/// a `[m, k]`, b `[n, k]` → `[m, n]`
pub(super) fn multiply_transposed(arch: Arch, a: &[f32], b: &[f32], k: usize) -> Vec<f32> {
    product_of(arch, a, &Packed::transposed(b, [b.len() / k, k]))
}

/// Computes `c += aᵀ · b`: the gradient of a kernel from its input and the gradient of its output.
///
/// # Shapes
/// a `[rows, m]`, b `[rows, n]`, c `[m, n]`
pub(super) fn add_transposed(arch: Arch, a: &[f32], m: usize, b: &[f32], n: usize, c: &mut [f32]) {
    debug_assert_eq!((a.len() / m, c.len()), (b.len() / n, m * n));
    arch.dispatch(AddTransposed { a, m, b, n, c });
}

struct Product<'a> {
    a: &'a [f32],
    k: usize,
    n: usize,
    panels: &'a [f32],
    /// Columns of a panel; the last may have fewer.
    width: usize,
    base: Base<'a>,
    relu: bool,
    c: &'a mut [f32],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, k, n, panels, width, base, relu, c } = self;
        let mut first = 0;
        for panel in panels.chunks(k * width) {
            let width = panel.len() / k;
            Block { k, panel, width, first, n, base, relu }.run(simd, a, c);
            first += width;
        }
    }
}

/// A panel, and the position of its columns in the result.
struct Block<'a> {
    k: usize,
    /// `[k, width]`
    panel: &'a [f32],
    width: usize,
    /// First column in the result.
    first: usize,
    /// Number of columns of the result.
    n: usize,
    base: Base<'a>,
    relu: bool,
}

/// Computes `c = base + a · b` for a narrow `b` that needs no packing, inside a dispatched operation.
///
/// # Shapes
/// a `[m, k]`, b `[k, n]`, c `[m, n]`
#[inline(always)]
pub(super) fn small_product<S: Simd>(simd: S, a: &[f32], b: &[f32], k: usize, base: Base<'_>, c: &mut [f32]) {
    let n = b.len() / k;
    simd.vectorize(Product { a, k, n, panels: b, width: n, base, relu: false, c });
}

/// Computes `c += aᵀ · b` inside a dispatched operation.
///
/// # Shapes
/// As in [`add_transposed`].
#[inline(always)]
pub(super) fn small_add_transposed<S: Simd>(simd: S, a: &[f32], m: usize, b: &[f32], n: usize, c: &mut [f32]) {
    simd.vectorize(AddTransposed { a, m, b, n, c });
}

impl Block<'_> {
    #[inline(always)]
    fn run<S: Simd>(&self, simd: S, a: &[f32], c: &mut [f32]) {
        let m = a.len() / self.k;
        let mut row = 0;
        while row < m {
            row += match m - row {
                6.. => self.rows::<S, 6>(simd, a, row, c),
                4 | 5 => self.rows::<S, 4>(simd, a, row, c),
                2 | 3 => self.rows::<S, 2>(simd, a, row, c),
                _ => self.rows::<S, 1>(simd, a, row, c),
            };
        }
    }

    /// Computes all columns of `M` rows.
    #[inline(always)]
    fn rows<S: Simd, const M: usize>(&self, simd: S, a: &[f32], row: usize, c: &mut [f32]) -> usize {
        let lanes = S::F32_LANES;
        let mut column = 0;
        // 8 lanes mean AVX2 with 16 registers, which 6 rows of 2 vectors fill.
        while lanes != 8 && column + 4 * lanes <= self.width {
            self.tile::<S, M, 4>(simd, a, row, column, c);
            column += 4 * lanes;
        }
        while column + 2 * lanes <= self.width {
            self.tile::<S, M, 2>(simd, a, row, column, c);
            column += 2 * lanes;
        }
        while column + lanes <= self.width {
            self.tile::<S, M, 1>(simd, a, row, column, c);
            column += lanes;
        }
        if column < self.width && self.width >= lanes && matches!(self.base, Base::Zero) {
            // Recomputes some columns, which takes less time than loading a partial vector.
            self.tile::<S, M, 1>(simd, a, row, self.width - lanes, c);
        } else if column < self.width {
            self.tail::<S, M>(simd, a, row, column, c);
        }
        M
    }

    #[inline(always)]
    fn tile<S: Simd, const M: usize, const V: usize>(
        &self,
        simd: S,
        a: &[f32],
        row: usize,
        column: usize,
        c: &mut [f32],
    ) {
        let n = V * S::F32_LANES;
        let sums = sum_tile::<S, M, V>(simd, self.k, &a[row * self.k..], self.panel, self.width, column);
        for (r, sums) in sums.into_iter().enumerate() {
            let at = (row + r) * self.n + self.first + column;
            let base: [S::f32s; V] = match self.base {
                Base::Zero => [simd.splat_f32s(0.0); V],
                Base::Kept => vectors::<S, V>(&c[at..]),
                Base::Bias(bias) => vectors::<S, V>(&bias[self.first + column..]),
                Base::PerGraph(rows) => vectors::<S, V>(&rows[(row + r) / 16 * self.n + self.first + column..]),
            };
            let (out, _) = S::as_mut_simd_f32s(&mut c[at..at + n]);
            for v in 0..V {
                let sum = simd.add_f32s(sums[v], base[v]);
                out[v] = if self.relu { simd.max_f32s(sum, simd.splat_f32s(0.0)) } else { sum };
            }
        }
    }

    /// Computes the columns that do not fill a vector.
    #[inline(always)]
    fn tail<S: Simd, const M: usize>(&self, simd: S, a: &[f32], row: usize, column: usize, c: &mut [f32]) {
        let k = self.k;
        let n = self.width - column;
        let a = rows::<M>(&a[row * k..], k);
        let mut sums = [simd.splat_f32s(0.0); M];
        for (p, line) in self.panel.chunks_exact(self.width).enumerate().take(k) {
            let line = simd.partial_load_f32s(&line[column..]);
            for (sum, a) in sums.iter_mut().zip(&a) {
                *sum = simd.mul_add_f32s(simd.splat_f32s(a[p]), line, *sum);
            }
        }
        for (r, sum) in sums.into_iter().enumerate() {
            let at = (row + r) * self.n + self.first + column;
            let out = &mut c[at..at + n];
            let base = match self.base {
                Base::Zero => simd.splat_f32s(0.0),
                Base::Kept => simd.partial_load_f32s(out),
                Base::Bias(bias) => simd.partial_load_f32s(&bias[self.first + column..][..n]),
                Base::PerGraph(rows) => {
                    let at = (row + r) / 16 * self.n + self.first + column;
                    simd.partial_load_f32s(&rows[at..at + n])
                }
            };
            let sum = simd.add_f32s(sum, base);
            let sum = if self.relu { simd.max_f32s(sum, simd.splat_f32s(0.0)) } else { sum };
            simd.partial_store_f32s(out, sum);
        }
    }
}

/// Returns the first `V` vectors of a slice.
#[inline(always)]
fn vectors<S: Simd, const V: usize>(values: &[f32]) -> [S::f32s; V] {
    let (values, _) = S::as_simd_f32s(&values[..V * S::F32_LANES]);
    // Not `array::from_fn`, which is not always inlined.
    let mut vectors = [values[0]; V];
    vectors.copy_from_slice(&values[..V]);
    vectors
}

/// Returns the first `M` rows of a matrix of `k` columns.
#[inline(always)]
fn rows<const M: usize>(a: &[f32], k: usize) -> [&[f32]; M] {
    let mut rows = [&a[..k]; M];
    for r in 1..M {
        rows[r] = &a[r * k..][..k];
    }
    rows
}

/// Multiplies `M` rows by `V` vectors of columns of a panel `[k, width]`.
///
/// Lengths and positions are plain arguments, and every row is cut to `k`, so the loop needs no bounds checks.
#[inline(always)]
fn sum_tile<S: Simd, const M: usize, const V: usize>(
    simd: S,
    k: usize,
    a: &[f32],
    panel: &[f32],
    width: usize,
    column: usize,
) -> [[S::f32s; V]; M] {
    let a = rows::<M>(a, k);
    let mut sums = [[simd.splat_f32s(0.0); V]; M];
    for (p, line) in panel.chunks_exact(width).enumerate().take(k) {
        let line = vectors::<S, V>(&line[column..]);
        for (sums, a) in sums.iter_mut().zip(&a) {
            let x = simd.splat_f32s(a[p]);
            for (sum, line) in sums.iter_mut().zip(line) {
                *sum = simd.mul_add_f32s(x, line, *sum);
            }
        }
    }
    sums
}

struct AddTransposed<'a> {
    a: &'a [f32],
    m: usize,
    b: &'a [f32],
    n: usize,
    c: &'a mut [f32],
}

impl WithSimd for AddTransposed<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, m, b, n, c } = self;
        let lanes = S::F32_LANES;
        for (a, b) in a.chunks(ROWS * m).zip(b.chunks(ROWS * n)) {
            let sum = Sum { a, m, b, n };
            let mut column = 0;
            while lanes != 8 && column + 4 * lanes <= n {
                sum.columns::<S, 4>(simd, column, c);
                column += 4 * lanes;
            }
            while column + 2 * lanes <= n {
                sum.columns::<S, 2>(simd, column, c);
                column += 2 * lanes;
            }
            while column + lanes <= n {
                sum.columns::<S, 1>(simd, column, c);
                column += lanes;
            }
            if column < n {
                sum.tail(simd, column, c);
            }
        }
    }
}

/// Computes `M` rows and `V` vectors of columns of a sum of outer products of the rows of a and b.
#[inline(always)]
fn sum_outer<S: Simd, const M: usize, const V: usize>(
    simd: S,
    [a, b]: [&[f32]; 2],
    [m, n]: [usize; 2],
    [row, column]: [usize; 2],
) -> [[S::f32s; V]; M] {
    let mut sums = [[simd.splat_f32s(0.0); V]; M];
    for (a, b) in a.chunks_exact(m).zip(b.chunks_exact(n)) {
        let b = vectors::<S, V>(&b[column..]);
        let Some(a) = a[row..].first_chunk::<M>() else { break };
        for r in 0..M {
            let x = simd.splat_f32s(a[r]);
            for v in 0..V {
                sums[r][v] = simd.mul_add_f32s(x, b[v], sums[r][v]);
            }
        }
    }
    sums
}

/// A sum of outer products of the rows of a and b.
struct Sum<'a> {
    a: &'a [f32],
    m: usize,
    b: &'a [f32],
    n: usize,
}

impl Sum<'_> {
    /// Computes all rows of `V` vectors of columns.
    #[inline(always)]
    fn columns<S: Simd, const V: usize>(&self, simd: S, column: usize, c: &mut [f32]) {
        let mut row = 0;
        while row < self.m {
            row += match self.m - row {
                6.. => self.tile::<S, 6, V>(simd, row, column, c),
                4 | 5 => self.tile::<S, 4, V>(simd, row, column, c),
                2 | 3 => self.tile::<S, 2, V>(simd, row, column, c),
                _ => self.tile::<S, 1, V>(simd, row, column, c),
            };
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const M: usize, const V: usize>(
        &self,
        simd: S,
        row: usize,
        column: usize,
        c: &mut [f32],
    ) -> usize {
        let columns = column..column + V * S::F32_LANES;
        let sums = sum_outer::<S, M, V>(simd, [self.a, self.b], [self.m, self.n], [row, column]);
        for r in 0..M {
            let (out, _) = S::as_mut_simd_f32s(&mut c[(row + r) * self.n..][columns.clone()]);
            for v in 0..V {
                out[v] = simd.add_f32s(out[v], sums[r][v]);
            }
        }
        M
    }

    /// Computes the columns that do not fill a vector.
    #[inline(always)]
    fn tail<S: Simd>(&self, simd: S, column: usize, c: &mut [f32]) {
        for row in 0..self.m {
            let mut sum = simd.splat_f32s(0.0);
            for (a, b) in self.a.chunks_exact(self.m).zip(self.b.chunks_exact(self.n)) {
                sum = simd.mul_add_f32s(simd.splat_f32s(a[row]), simd.partial_load_f32s(&b[column..]), sum);
            }
            let out = &mut c[row * self.n..][column..self.n];
            let sum = simd.add_f32s(simd.partial_load_f32s(out), sum);
            simd.partial_store_f32s(out, sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(n: usize, seed: usize) -> Vec<f32> {
        (0..n).map(|i| ((i * 37 + seed * 101) % 19) as f32 / 4.0 - 2.0).collect()
    }

    /// Sums of eighths and sixteenths of small integers are exact in any order.
    fn expected(a: &[f32], b: &[f32], k: usize) -> Vec<f32> {
        let n = b.len() / k;
        let entry = |row: usize, column: usize| (0..k).map(|p| a[row * k + p] * b[p * n + column]).sum::<f32>();
        (0..a.len() / k).flat_map(|row| (0..n).map(move |column| (row, column))).map(|(r, c)| entry(r, c)).collect()
    }

    fn transpose(a: &[f32], columns: usize) -> Vec<f32> {
        (0..columns).flat_map(|column| a.iter().copied().skip(column).step_by(columns)).collect()
    }

    #[test]
    fn products_of_all_shapes_equal_the_definition() {
        let arch = Arch::new();
        for (m, k, n) in [(1, 1, 1), (2, 3, 5), (7, 4, 16), (16, 25, 24), (11, 64, 96), (32, 130, 70), (5, 2, 200)] {
            let (a, b) = (numbers(m * k, 1), numbers(k * n, 2));
            let wanted = expected(&a, &b, k);
            assert_eq!(multiply(arch, &a, &b, k), wanted, "{m} {k} {n}");
            assert_eq!(multiply_transposed(arch, &a, &transpose(&b, n), k), wanted, "{m} {k} {n} transposed");
            let mut c = vec![1.0; m * n];
            add_transposed(arch, &transpose(&a, k), m, &b, n, &mut c);
            assert!(c.iter().zip(&wanted).all(|(c, w)| *c == w + 1.0), "{m} {k} {n} sum");
        }
    }

    #[test]
    fn bases_are_added_before_the_cut_at_zero() {
        let arch = Arch::new();
        let (m, k, n) = (32, 3, 21);
        let a = numbers(m * k, 3);
        let b = numbers(k * n, 4);
        let bias = numbers(n, 5);
        let graphs = numbers(m / 16 * n, 6);
        let w = Packed::new(&b, [k, n]);
        let plain = expected(&a, &b, k);
        let mut c = vec![0.25; m * n];
        product(arch, &a, &w, Base::Kept, false, &mut c);
        assert!(c.iter().zip(&plain).all(|(c, p)| *c == p + 0.25));
        product(arch, &a, &w, Base::Bias(&bias), true, &mut c);
        assert!((0..m * n).all(|i| c[i] == (plain[i] + bias[i % n]).max(0.0)));
        product(arch, &a, &w, Base::PerGraph(&graphs), true, &mut c);
        assert!((0..m * n).all(|i| c[i] == (plain[i] + graphs[i / n / 16 * n + i % n]).max(0.0)));
    }
}
