//! What several of these tests need: the program, a browser, a page, a line that can be cut, and judges in Python.

pub(crate) mod judges;
pub(crate) mod line;
pub(crate) mod program;
pub(crate) mod served;
pub(crate) mod webdriver;
