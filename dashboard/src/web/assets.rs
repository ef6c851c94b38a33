//! The page's own files, which are embedded in the binary, and how browsers keep them.

use axum::body::Bytes;
use axum::http::header::{ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get};

/// A file of the page: path, content type and text.
pub(super) type Asset = (&'static str, &'static str, &'static str);

const JS: &str = "text/javascript; charset=utf-8";

/// The modules with these names, each at the path by which the others import it.
macro_rules! modules {
    ($($name:literal)*) => {
        [$((concat!("/", $name, ".js"), JS, include_str!(concat!("assets/", $name, ".js")))),*]
    };
}

/// The page itself, and what is no module of our own.
const OTHERS: [Asset; 6] = [
    ("/", "text/html; charset=utf-8", include_str!("assets/page.html")),
    ("/style.css", "text/css; charset=utf-8", include_str!("assets/style.css")),
    ("/icon.svg", "image/svg+xml", include_str!("assets/icon.svg")),
    ("/three.js", JS, include_str!("assets/vendor/three.min.js")),
    ("/uplot.css", "text/css; charset=utf-8", include_str!("assets/vendor/uplot.min.css")),
    ("/uplot.js", JS, include_str!("assets/vendor/uplot.min.js")),
];

/// The page's modules. Those of the 3D view are loaded when the first episode is shown or the user starts to draw.
const MODULES: [Asset; 38] = modules!(
    "address" "app" "attention" "axes" "chart" "curves" "draft" "draw" "drawing" "editor" "follow" "format" "gallery"
    "grippers" "ground" "hand" "health" "heat" "labels" "magnets" "model" "occlusion" "options" "origin" "pointer"
    "replay" "share" "snapshots" "solid" "space" "stage" "sweep" "terms" "ticks" "upright" "verdict" "videos" "view"
);

/// Returns all files.
pub(super) fn all() -> impl Iterator<Item = Asset> {
    OTHERS.into_iter().chain(MODULES)
}

/// The libraries, compressed: they are most of what a browser loads.
const PACKED: [(&str, &[u8]); 2] = [
    ("/three.js", include_bytes!("assets/vendor/three.min.js.gz")),
    ("/uplot.js", include_bytes!("assets/vendor/uplot.min.js.gz")),
];

/// Modules to load early if the page opens with an episode.
const PRELOADS: &str =
    "<link rel=\"modulepreload\" href=\"/space.js\"><link rel=\"modulepreload\" href=\"/three.js\">\n";

/// Serves a file; the page itself loads the 3D view early if it `opens` with an episode.
pub(super) fn route<S: Clone + Send + Sync + 'static>(
    (path, content_type, text): Asset,
    opens: bool,
) -> MethodRouter<S> {
    let text: Bytes = match path {
        "/" if opens => text.replace("</head>", &format!("{PRELOADS}</head>")).into(),
        _ => Bytes::from_static(text.as_bytes()),
    };
    let packed = PACKED.iter().find(|(of, _)| *of == path).map(|(_, bytes)| Bytes::from_static(bytes));
    let tag = format!("\"{:016x}\"", proto::config_hash(&String::from_utf8_lossy(&text)));
    get(move |headers: HeaderMap| std::future::ready(answer(&headers, content_type, &tag, &text, packed.as_ref())))
}

/// Returns the file, or tells a browser that kept it that it is still the same.
fn answer(
    headers: &HeaderMap,
    content_type: &'static str,
    tag: &str,
    text: &Bytes,
    packed: Option<&Bytes>,
) -> Response {
    let has = |name: HeaderName, word: &str| {
        let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
        values.flat_map(|value| value.split(',')).any(|one| one.trim() == word)
    };
    // `no-cache` lets a browser keep a file and makes it ask each time whether there is a newer one.
    let kept = [(CACHE_CONTROL, "no-cache"), (ETAG, tag), (VARY, "accept-encoding")];
    if has(IF_NONE_MATCH, tag) {
        return (StatusCode::NOT_MODIFIED, kept).into_response();
    }
    match packed.filter(|_| has(ACCEPT_ENCODING, "gzip")) {
        Some(packed) => {
            (kept, [(CONTENT_TYPE, content_type), (CONTENT_ENCODING, "gzip")], packed.clone()).into_response()
        }
        None => (kept, [(CONTENT_TYPE, content_type)], text.clone()).into_response(),
    }
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn the_compressed_files_are_those_of_the_libraries() {
        let bit = |crc: u32, _| (crc >> 1) ^ (0xedb8_8320 & 0_u32.wrapping_sub(crc & 1));
        for (name, packed) in PACKED {
            let (_, _, text) = all().find(|(path, ..)| *path == name).unwrap();
            // The end of a gzip file: the checksum of the content, and its length.
            let checksum = !text.bytes().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(byte), bit));
            let end = [checksum.to_le_bytes(), (text.len() as u32).to_le_bytes()].concat();
            assert!(packed.ends_with(&end), "compress {name} again, as vendor/README.md says");
        }
    }

    #[test]
    fn a_browser_keeps_a_file_until_it_changes() {
        let (text, packed) = (Bytes::from_static(b"text"), Bytes::from_static(b"packed"));
        let asked = |headers: &[(HeaderName, &'static str)]| {
            let headers = headers.iter().map(|(name, value)| (name.clone(), HeaderValue::from_static(value)));
            let answer = answer(&headers.collect(), JS, "\"1\"", &text, Some(&packed));
            (answer.status().as_u16(), answer.headers().get(CONTENT_ENCODING).is_some())
        };
        assert_eq!(asked(&[]), (200, false));
        assert_eq!(asked(&[(ACCEPT_ENCODING, "deflate, gzip")]), (200, true));
        assert_eq!(asked(&[(IF_NONE_MATCH, "\"0\"")]), (200, false));
        assert_eq!(asked(&[(IF_NONE_MATCH, "\"0\", \"1\"")]), (304, false));
    }
}
