//! Videos of evaluations: their list and their contents.

use std::path::Path;

use blueprints::{Catalog, outside};
use proto::Trajectory;
use proto::codec::{MAX_RECORDING_BYTES, decode_recording};
use render::picture::encode;
use render::video::{Episode, LAST_S, MIN_WIDTH, Video};
use runlog::RunPaths;
use runlog::videos::{RECORDING, VideoFile, videos};
use serde_json::{Value, json};

/// Maximum number of listed videos.
const MAX_LISTED: usize = 60;

/// Maximum size of a served video in bytes. A video of 100 steps is below 2 MB.
const MAX_BYTES: u64 = 32 << 20;

/// Width of a video's still image in pixels.
const POSTER_PX: usize = MIN_WIDTH;

/// Number of colors in that image.
const N_COLORS: usize = 96;

/// Videos and recordings of a run, read from their folders on every request; `None` has no videos.
#[derive(Clone, Debug)]
pub(super) struct Videos(pub(super) Option<RunPaths>);

impl Videos {
    /// Returns the newest videos as sent to the browser, newest first, each with its `id` in `/api/video?id=`.
    pub(super) fn list(&self) -> Value {
        let view = |video: &VideoFile| {
            let VideoFile { blueprint, label, .. } = video;
            let version = label.version;
            let ending = label.ending.name();
            json!({ "id": id(video), "blueprint": blueprint, "weights_version": version, "ending": ending })
        };
        self.all().iter().take(MAX_LISTED).map(view).collect()
    }

    /// Returns the bytes of the video with this id. The id is compared with the existing videos and never used as a path.
    pub(super) fn bytes(&self, asked: &str) -> Option<Vec<u8>> {
        let video = self.all().into_iter().find(|video| id(video) == asked)?;
        outside::read(&video.path, MAX_BYTES).ok()
    }

    /// Returns the recorded episode of the video with this id.
    pub(super) fn recording(&self, asked: &str) -> Option<Trajectory> {
        let video = self.all().into_iter().find(|video| id(video) == asked)?;
        let name = Path::new(video.path.file_name()?).with_extension(RECORDING);
        let path = self.0.as_ref()?.replays().join(video.blueprint.as_str()).join(name);
        decode_recording(&outside::read(&path, MAX_RECORDING_BYTES as u64).ok()?).ok()
    }

    /// Returns a PNG of the last scene of the video with this id; `None` without a recording or if the goal is unknown.
    pub(super) fn poster(&self, catalog: &Catalog, asked: &str) -> Option<Vec<u8>> {
        let recording = self.recording(asked)?;
        let goal = catalog.get(&recording.task.blueprint)?;
        let episode = Episode::new(&recording, goal).ok()?;
        let frame = Video::new(&episode, POSTER_PX).frame(episode.length_s() + LAST_S);
        encode(&frame, N_COLORS).ok()
    }

    fn all(&self) -> Vec<VideoFile> {
        self.0.as_ref().map(|run| videos(&run.videos(), "mp4")).unwrap_or_default()
    }
}

fn id(video: &VideoFile) -> String {
    let VideoFile { blueprint, label, .. } = video;
    format!("{blueprint}.{}.{}", label.version.0, label.ending.name())
}
