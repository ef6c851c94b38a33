//! Queries of the page.

/// Returns the value of a query of the form `id=…`; empty for any other query.
pub(super) fn id_of(query: Option<String>) -> String {
    query.as_deref().and_then(|query| query.strip_prefix("id=")).unwrap_or_default().to_owned()
}
