//! The gallery: the list of blueprints and a small picture of each.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::{Extension, RawQuery};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use blueprints::{Blueprint, BlueprintId, Catalog, Group};
use parking_lot::Mutex;
use render::picture::{Painter, View, draw_blueprint, encode};
use serde_json::{Value, json};

use super::query::id_of;

/// Width and height of a picture in pixels.
const SIZE_PX: [usize; 2] = [200, 150];

/// Number of colors in a picture.
const N_COLORS: usize = 96;

/// How long browsers may cache a picture. Built-in blueprints never change within a version.
const KEPT: &str = "private, max-age=86400";

/// Cache of requested pictures; at most as many as the catalog has blueprints.
#[derive(Debug, Default)]
pub(super) struct Gallery(Mutex<BTreeMap<BlueprintId, Bytes>>);

impl Gallery {
    /// Returns the PNG of a blueprint in the catalog. Draws one at a time, each in around ten milliseconds.
    fn picture(&self, catalog: &Catalog, id: &str) -> Option<Bytes> {
        let blueprint = catalog.get(&id.parse().ok()?)?;
        let mut drawn = self.0.lock();
        if let Some(known) = drawn.get(blueprint.id()) {
            return Some(known.clone());
        }
        let image = draw_blueprint(&mut Painter::default(), blueprint, View::FrontQuarter, SIZE_PX);
        let bytes = Bytes::from(encode(&image, N_COLORS).ok()?);
        drawn.insert(blueprint.id().clone(), bytes.clone());
        Some(bytes)
    }
}

/// Returns all blueprints of the catalog, in its order.
pub(super) fn list(catalog: &Catalog) -> Value {
    let entry = |blueprint: &Blueprint| {
        let n_blocks = blueprint.n_blocks();
        let group = Group::of(blueprint.split(), n_blocks);
        json!({ "id": blueprint.id(), "title": blueprint.title(), "n_blocks": n_blocks, "group": group.map(Group::name) })
    };
    let blueprints: Vec<_> = catalog.iter().map(entry).collect();
    json!({ "schema_version": 1, "blueprints": blueprints })
}

/// Returns the picture of the blueprint named in the query.
pub(super) async fn picture(
    Extension(gallery): Extension<Arc<Gallery>>,
    Extension(catalog): Extension<Arc<Catalog>>,
    RawQuery(query): RawQuery,
) -> Response {
    let asked = id_of(query);
    // A user's own blueprint file may change before the next start.
    let is_ours = asked.parse().is_ok_and(|id| Catalog::builtin().get(&id) == catalog.get(&id));
    let kept = if is_ours { KEPT } else { "no-store" };
    match tokio::task::spawn_blocking(move || gallery.picture(&catalog, &asked)).await {
        Ok(Some(bytes)) => ([(CONTENT_TYPE, "image/png"), (CACHE_CONTROL, kept)], bytes).into_response(),
        Ok(None) => StatusCode::NOT_FOUND.into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_small_and_of_the_catalog_alone() {
        let (gallery, catalog) = (Gallery::default(), Catalog::builtin());
        let first = gallery.picture(catalog, "16_002").unwrap();
        assert!(first.starts_with(b"\x89PNG") && first.len() < 30_000, "{}", first.len());
        assert_eq!(gallery.picture(catalog, "16_002").unwrap(), first);
        assert_eq!(gallery.picture(catalog, "../eval.db"), None);
        assert_eq!(gallery.picture(catalog, "99_999"), None);
    }
}
