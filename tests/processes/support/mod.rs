//! What several of these tests share: the program, a browser, a page, a connection that can be cut, handmade runs, and
//! Python readers.

pub(crate) mod judges;
pub(crate) mod line;
pub(crate) mod played;
pub(crate) mod program;
pub(crate) mod served;
pub(crate) mod webdriver;
pub(crate) mod written;
