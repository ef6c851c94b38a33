//! Values that are kept up to date.

use std::fmt::Debug;

use tokio::sync::watch;

use super::Bus;

/// A value of other processes that is kept up to date until this is dropped.
#[derive(Debug)]
pub struct Followed<T> {
    pub(super) value: watch::Receiver<T>,
    /// Keeps it up to date.
    pub(super) _source: Box<dyn Debug + Send + Sync>,
    pub(super) _open: Bus,
}

impl<T> Followed<T> {
    /// Returns a receiver of the value and of every change.
    pub fn watch(&self) -> watch::Receiver<T> {
        self.value.clone()
    }
}
