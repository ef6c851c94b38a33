//! Distances between structures, and a selection of the most different ones.

use blueprints::{Blueprint, Inventory};

/// Returns features of a structure's composition and appearance, all on about the same scale.
fn features(blueprint: &Blueprint) -> Vec<f64> {
    let inventory = Inventory::standard();
    let n_blocks = blueprint.n_blocks() as f64;
    let mut features: Vec<f64> = (0..inventory.types().len())
        .map(|t| blueprint.placements().iter().filter(|p| inventory.type_idx(p.block) == t).count() as f64 / n_blocks)
        .collect();
    let cells: Vec<[i32; 3]> = blueprint.placements().iter().flat_map(|p| p.filled_cells()).collect();
    let [x, y, height] = blueprint.extent_u().map(f64::from);
    let (long, short) = (x.max(y), x.min(y));
    let n_loops = (blueprint.links().len() + 1) as f64 - n_blocks;
    let upright = blueprint.placements().iter().filter(|p| p.size_cells()[2] > 1).count() as f64;
    let on_ground = cells.iter().filter(|cell| cell[2] == 0).count() as f64;
    features.extend([
        n_loops / n_blocks,
        upright / n_blocks,
        height / (height + long),
        short / (short + long),
        cells.len() as f64 / (long * short * height),
        on_ground / cells.len() as f64,
        (height + long) / (2.0 * n_blocks),
    ]);
    features
}

/// Selects `count` structures, each the farthest from its nearest selected neighbor; the result is in pool order.
///
/// Selection begins with the first structure; ties go to the first.
pub(super) fn most_different(pool: Vec<Blueprint>, count: usize) -> Vec<Blueprint> {
    let features: Vec<Vec<f64>> = pool.iter().map(features).collect();
    let distance = |i: usize, j: usize| features[i].iter().zip(&features[j]).map(|(a, b)| (a - b).abs()).sum::<f64>();
    let mut is_chosen = vec![false; pool.len()];
    let mut to_nearest = vec![f64::INFINITY; pool.len()];
    for _ in 0..count.min(pool.len()) {
        let mut farthest: Option<usize> = None;
        for i in (0..pool.len()).filter(|&i| !is_chosen[i]) {
            if farthest.is_none_or(|best| to_nearest[i] > to_nearest[best]) {
                farthest = Some(i);
            }
        }
        let Some(next) = farthest else { break };
        is_chosen[next] = true;
        for (i, nearest) in to_nearest.iter_mut().enumerate() {
            *nearest = nearest.min(distance(i, next));
        }
    }
    pool.into_iter().zip(is_chosen).filter_map(|(blueprint, chosen)| chosen.then_some(blueprint)).collect()
}
