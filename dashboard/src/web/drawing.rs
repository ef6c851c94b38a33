//! User-drawn structures: checks and rotates their blocks, and returns the problems or a blueprint file.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::{Extension, RawQuery};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use blueprints::drawing::{Connection, Drawing, Problem, word};
use blueprints::{BlueprintId, Catalog, Inventory, UNIT_M};
use render::picture::TYPE_COLORS;
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::Semaphore;

use super::query::id_of;

/// Maximum size of a drawing in bytes, as JSON or as a file. Sixteen blocks take about two thousand.
pub(super) const MAX_BYTES: usize = 64 << 10;

/// Runs checks one at a time: the search for an assembly order can take a second.
#[derive(Clone, Debug)]
pub(super) struct OneCheck(pub(super) Arc<Semaphore>);

/// A drawing that the page sent, and the results of checking it.
#[derive(Debug, Serialize)]
struct Findings {
    schema_version: u32,
    #[serde(flatten)]
    drawing: Drawing,
    problems: Vec<Problem>,
    connections: Vec<Connection>,
    /// Text of the blueprint file, if there are no problems and at least two blocks.
    toml: Option<String>,
}

/// Parses a drawing. JSON starts with a brace, which no blueprint file does.
fn read(body: &[u8]) -> Result<Drawing, String> {
    let text = std::str::from_utf8(body).map_err(|_| "the drawing is not text".to_owned())?;
    if !text.trim_start().starts_with('{') {
        return Drawing::from_toml(text).map_err(|error| error.to_string());
    }
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// Parses a drawing, rotates its free blocks and checks it.
fn look(body: &[u8]) -> Result<Findings, String> {
    let mut drawing = read(body)?;
    drawing.turn_free_blocks().map_err(|error| error.to_string())?;
    let found = drawing.examine().map_err(|error| error.to_string())?;
    Ok(Findings {
        schema_version: 1,
        drawing,
        problems: found.problems,
        connections: found.connections,
        toml: found.blueprint.map(|blueprint| blueprint.to_toml("drawn on the page of lodestone")),
    })
}

/// Checks the drawing in the request body, which is JSON or the text of a blueprint file.
pub(super) async fn check(Extension(one_check): Extension<OneCheck>, body: Bytes) -> Response {
    let Ok(turn) = one_check.0.acquire_owned().await else { return StatusCode::INTERNAL_SERVER_ERROR.into_response() };
    let looked = tokio::task::spawn_blocking(move || {
        // A check continues after its browser disconnects, and the next one waits for it.
        let _turn = turn;
        look(&body).map(|found| serde_json::to_vec(&found))
    });
    match looked.await {
        Ok(Ok(Ok(json))) => ([(CONTENT_TYPE, "application/json")], json).into_response(),
        Ok(Err(reason)) => (StatusCode::BAD_REQUEST, reason + "\n").into_response(),
        Ok(Ok(Err(_))) | Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// Returns the types of blocks available for drawing.
pub(super) fn inventory() -> Value {
    let kind = |(i, of): (usize, &blueprints::BlockType)| {
        let color = TYPE_COLORS[i % TYPE_COLORS.len()];
        json!({ "type": of.name, "word": word(of.name), "cells": of.cells, "count": of.count, "color": color })
    };
    let types: Vec<_> = Inventory::standard().types().iter().enumerate().map(kind).collect();
    json!({ "schema_version": 1, "unit_m": UNIT_M, "types": types })
}

/// Returns the file of the blueprint named in the query.
pub(super) async fn file(Extension(catalog): Extension<Arc<Catalog>>, RawQuery(query): RawQuery) -> Response {
    let id = id_of(query).parse::<BlueprintId>().ok();
    match id.and_then(|id| catalog.get(&id).map(|blueprint| blueprint.to_toml(&format!("a copy of {id}")))) {
        Some(text) => ([(CONTENT_TYPE, "application/toml")], text).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use blueprints::checks::Check;

    use super::*;

    fn block(kind: &str, at: [i64; 3], axes: &str) -> Value {
        json!({ "type": kind, "at": at, "axes": axes })
    }

    fn drawing(title: &str, blocks: &[Value]) -> Vec<u8> {
        json!({ "title": title, "blocks": blocks }).to_string().into_bytes()
    }

    #[test]
    fn a_drawing_comes_back_turned_and_as_a_file() {
        let drawn = |is_free: bool| {
            let mut blocks = [block("1x1x1", [0, 0, 0], "+x +y"), block("1x1x1", [0, 0, 1], "+x -y")];
            blocks[1]["is_free"] = is_free.into();
            look(&drawing("two cubes", &blocks)).unwrap()
        };
        let repelled = drawn(false);
        let problem = &repelled.problems[0];
        assert_eq!((problem.check, &problem.blocks[..]), (Check::Polarity, &[0, 1][..]));
        assert_eq!(repelled.toml, None);
        let turned = drawn(true);
        assert_eq!((turned.problems.len(), turned.connections.len()), (0, 1));
        assert_ne!(turned.drawing.blocks[1].axes, "+x -y");
        let again = look(turned.toml.unwrap().as_bytes()).unwrap();
        assert_eq!((again.drawing.title.as_str(), again.problems.len()), ("two cubes", 0));
        assert!(again.toml.unwrap().contains("drawn_2_"));
    }

    #[test]
    fn every_blueprint_can_be_drawn_on() {
        for blueprint in Catalog::builtin().iter() {
            let found = look(blueprint.to_toml("a test").as_bytes()).unwrap();
            assert_eq!((found.drawing.blocks.len(), found.problems.len()), (blueprint.n_blocks(), 0));
        }
    }

    #[test]
    fn strangers_are_told_what_is_wrong() {
        let deep = "[".repeat(30_000);
        let one = |kind: &str, z: i64, axes: &str| drawing("", &[block(kind, [0, 0, z], axes)]);
        let many = drawing("", &vec![block("1x1x1", [0; 3], "+x +y"); 900]);
        for (body, words) in [
            (&b"\xff\xfe"[..], "not text"),
            (b"", "missing field"),
            (b"{", "EOF"),
            (b"{}", "missing field `title`"),
            (b"{\"title\":\"\",\"blocks\":[],\"more\":1}", "unknown field `more`"),
            (&one("1x1x1", 99_999_999_999, "+x +y"), "invalid value"),
            (&one("1x1x1", 2_147_483_647, "+x +y"), "outside -64..=64"),
            (&one("0x0x0", 0, "+x +y"), "unknown type"),
            (&one("1x1x1", 0, "up"), "not two different axes"),
            (&many, "one too many of type 1x1x1"),
            (format!("{{\"title\":\"\",\"blocks\":{deep}").as_bytes(), "invalid type"),
            (format!("a = {deep}").as_bytes(), "line 1"),
            (b"id = \"2_000\"", "line 1: missing field"),
        ] {
            let reason = look(body).unwrap_err();
            assert!(reason.contains(words), "{reason}");
        }
    }

    #[test]
    fn an_empty_drawing_and_a_single_block_have_no_problems_and_no_file() {
        let nothing = look(&drawing("", &[])).unwrap();
        assert_eq!((nothing.problems.len(), nothing.toml), (0, None));
        let one = look(&drawing("", &[block("4x1x1", [0, 0, 9], "+z +x")])).unwrap();
        assert_eq!((one.problems.len(), one.toml), (0, None));
    }
}
