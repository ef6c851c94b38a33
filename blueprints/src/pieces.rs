//! What hangs together in a structure.

/// Returns the lowest node of its connected component, for each of `n` nodes.
pub fn pieces(n: usize, edges: impl IntoIterator<Item = (usize, usize)>) -> Vec<usize> {
    let mut piece: Vec<usize> = (0..n).collect();
    for (a, b) in edges {
        let (low, high) = (piece[a].min(piece[b]), piece[a].max(piece[b]));
        piece.iter_mut().filter(|p| **p == high).for_each(|p| *p = low);
    }
    piece
}
