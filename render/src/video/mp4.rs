//! Encodes frames as an MP4 file with H.264, which every browser plays.

use muxide::api::{MuxerBuilder, VideoCodec};
use openh264::encoder::{
    Complexity, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, MatrixCoefficients, QpRange,
    RateControlMode, VuiConfig,
};
use openh264::formats::{RgbSliceU8, YUVBuffer};
use openh264::{OpenH264API, Timestamp};

use super::{MAX_FPS, VideoError};
use crate::picture::Image;

/// Interval between key frames in seconds, for seeking.
const KEY_FRAME_INTERVAL_S: u32 = 2;

/// Quantization parameter, 0 to 51: thin lines stay sharp, and a second takes a few tens of kilobytes.
const QP: u8 = 24;

/// Encodes the frames as MP4, `fps` (1 to [`MAX_FPS`]) per second. Equal frames give equal bytes on one machine.
///
/// Frames are consumed one at a time, so that a video need not fit into memory.
///
/// # Errors
/// Returns an error if there is no frame, the frame rate or size is not supported (see [`VideoError`]), or the encoder
/// fails.
pub fn mp4(frames: impl IntoIterator<Item = Image>, fps: u32) -> Result<Vec<u8>, VideoError> {
    if !(1..=MAX_FPS).contains(&fps) {
        return Err(VideoError::Rate(fps, MAX_FPS));
    }
    let mut frames = frames.into_iter().peekable();
    let first = frames.peek().ok_or(VideoError::NoFrames)?;
    let (width, height) = (first.width(), first.height());
    if width % 2 != 0 || height % 2 != 0 {
        return Err(VideoError::Size(width, height));
    }
    let side = |n: usize| u32::try_from(n).map_err(|_| VideoError::Size(width, height));
    let mut muxer =
        MuxerBuilder::new(Vec::new()).video(VideoCodec::H264, side(width)?, side(height)?, f64::from(fps)).build()?;
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config(fps))?;
    let mut planes = YUVBuffer::new(width, height);
    for (i, frame) in frames.enumerate() {
        if (frame.width(), frame.height()) != (width, height) {
            return Err(VideoError::Size(frame.width(), frame.height()));
        }
        planes.read_rgb8(RgbSliceU8::new(frame.pixels().as_flattened(), (width, height)));
        let coded = encoder.encode_at(&planes, Timestamp::from_millis(i as u64 * 1000 / u64::from(fps)))?;
        let is_key = matches!(coded.frame_type(), FrameType::IDR);
        let bytes = coded.to_vec();
        if bytes.is_empty() {
            return Err(VideoError::Dropped(i));
        }
        muxer.write_video(i as f64 / f64::from(fps), &bytes, is_key)?;
    }
    muxer.finish_in_place()?;
    Ok(muxer.into_writer())
}

fn config(fps: u32) -> EncoderConfig {
    EncoderConfig::new()
        .max_frame_rate(FrameRate::from_hz(fps as f32))
        // A file has no bandwidth limit: each frame gets the bits that its quality needs, and none is skipped.
        .rate_control_mode(RateControlMode::Off)
        .skip_frames(false)
        .qp(QpRange::new(QP, QP))
        .complexity(Complexity::Medium)
        .intra_frame_period(IntraFramePeriod::from_num_frames(KEY_FRAME_INTERVAL_S * fps))
        .scene_change_detect(false)
        // More threads would split a frame into slices, and the bytes would depend on the number of cores.
        .num_threads(1)
        // The conversion from RGB uses this matrix; without it, players guess another one from the size.
        .vui(VuiConfig::bt709().matrix_coefficients(MatrixCoefficients::Smpte170M))
}
