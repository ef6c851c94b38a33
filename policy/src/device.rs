//! Selection of the tensor device at run time.

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

/// Where the network runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceKind {
    /// The CPU: custom kernels for the graph network, burn's `flex` backend for everything else. Always available.
    #[default]
    Cpu,
    /// burn's `wgpu` backend (Vulkan or Metal, any vendor). Requires the cargo feature `gpu`.
    Gpu,
}

/// Why a device cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// The binary was built without the cargo feature `gpu`.
    #[error("this binary has no GPU backend: build it with `--features gpu`, or run with `--device cpu`")]
    NotBuiltIn,
    /// No adapter answered; the text is the driver's.
    #[error("no usable GPU: {0}; install its Vulkan driver, or run with `--device cpu`")]
    Unavailable(String),
}

impl DeviceKind {
    /// Opens the device. A GPU is probed here, once, because the backend's lazy initialization would panic on a worker
    /// thread.
    ///
    /// # Errors
    /// [`DeviceError`] if the backend is not built in or no adapter can be opened.
    pub fn open(self) -> Result<Device, DeviceError> {
        match self {
            Self::Cpu => Ok(Device::flex()),
            Self::Gpu => open_gpu(),
        }
    }
}

#[cfg(feature = "gpu")]
fn open_gpu() -> Result<Device, DeviceError> {
    use std::sync::OnceLock;
    // An adapter's runtime can be registered only once per process, so the first result is kept.
    static GPU: OnceLock<Result<Device, DeviceError>> = OnceLock::new();
    GPU.get_or_init(|| Device::wgpu_options().init().map_err(|error| DeviceError::Unavailable(error.to_string())))
        .clone()
}

#[cfg(not(feature = "gpu"))]
fn open_gpu() -> Result<Device, DeviceError> {
    Err(DeviceError::NotBuiltIn)
}
