//! Errors of Rust as exceptions of Python.

use std::error::Error;

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;

/// A `ValueError` with the message and the causes of an error.
pub(crate) fn refused(error: &dyn Error) -> PyErr {
    PyValueError::new_err(message(error))
}

/// The message and the causes of an error.
pub(crate) fn message(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let message = error.to_string();
        // Some errors already say their cause.
        if !text.contains(&message) {
            text.push_str(": ");
            text.push_str(&message);
        }
        cause = error.source();
    }
    text
}
