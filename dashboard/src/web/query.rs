//! What a query names.

/// What follows `id=`, if the query has nothing else.
pub(super) fn id_of(query: Option<String>) -> String {
    query.as_deref().and_then(|query| query.strip_prefix("id=")).unwrap_or_default().to_owned()
}
