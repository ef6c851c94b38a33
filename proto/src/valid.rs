//! Settings that have been checked.

use std::ops::Deref;
use std::sync::Arc;

use serde::{Serialize, Serializer};

use crate::setting::{InvalidSetting, Root, Section};

/// A section whose settings have all been checked, shared by everything that uses it.
///
/// Whatever enters a process as settings becomes one at the boundary, so nothing behind it checks again.
#[derive(Debug, PartialEq, Eq)]
pub struct Valid<T>(Arc<T>);

impl<T: Root> Valid<T> {
    /// Checks every setting.
    ///
    /// # Errors
    /// Names the first invalid setting, its value, and what is expected.
    pub fn new(section: T) -> Result<Self, InvalidSetting> {
        section.validate_at(T::KEY)?;
        Ok(Self(Arc::new(section)))
    }

    /// Returns a copy with a change.
    ///
    /// # Errors
    /// Those of [`Valid::new`].
    pub fn with(&self, change: impl FnOnce(&mut T)) -> Result<Self, InvalidSetting>
    where
        T: Clone,
    {
        let mut section = T::clone(self);
        change(&mut section);
        Self::new(section)
    }
}

impl<T> Valid<T> {
    /// Returns a section of this one, which was checked with it.
    pub fn part<U: Section + Clone>(&self, part: impl FnOnce(&T) -> &U) -> Valid<U> {
        Valid(Arc::new(part(self).clone()))
    }
}

impl<T: Clone> Valid<Option<T>> {
    /// Returns the section if there is one.
    pub fn transpose(&self) -> Option<Valid<T>> {
        self.as_ref().map(|section| Valid(Arc::new(section.clone())))
    }
}

impl<T: Root + Default> Default for Valid<T> {
    /// The defaults.
    ///
    /// # Panics
    /// If a default is outside its range, which each section's tests rule out.
    fn default() -> Self {
        Self::new(T::default()).expect("defaults are valid")
    }
}

impl<T> Clone for Valid<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T: Serialize> Serialize for Valid<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        T::serialize(self, serializer)
    }
}

impl<T> Deref for Valid<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}
