//! Converts Rust errors to Python exceptions.

use std::error::Error;

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;

/// Creates a `ValueError` with the message and the causes of an error.
pub(crate) fn refused(error: impl Error) -> PyErr {
    PyValueError::new_err(message(&error))
}

/// Returns the message and the causes of an error.
pub(crate) fn message(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let message = error.to_string();
        // Some errors already include their cause.
        if !text.contains(&message) {
            text.push_str(": ");
            text.push_str(&message);
        }
        cause = error.source();
    }
    text
}
