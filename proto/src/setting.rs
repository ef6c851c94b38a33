//! Settings: type, default, unit, and range in one place, with uniform error messages.
//!
//! ```
//! use proto::setting::above_to;
//!
//! proto::settings! {
//!     /// An inbox.
//!     pub struct InboxConfig in "inbox" {
//!         /// Maximum number of letters.
//!         pub capacity: usize = 64, in 1..=1024;
//!         /// Number of letters at which the inbox is checked.
//!         pub enough: usize = 8, where |c| c.enough <= c.capacity => "at most capacity";
//!         /// How the postman walks.
//!         pub walk: WalkConfig;
//!     }
//!
//!     /// A walk.
//!     pub struct WalkConfig {
//!         /// Speed, m/s.
//!         pub speed_mps: f32 = 1.5, in above_to(0.0, 10.0);
//!     }
//! }
//!
//! let config = InboxConfig { walk: WalkConfig { speed_mps: f32::NAN }, ..Default::default() };
//! let error = proto::Valid::new(config).unwrap_err().to_string();
//! assert_eq!(error, "inbox.walk.speed_mps = NaN: expected above 0 and at most 10");
//! ```

use std::fmt::Debug;

use serde::Serialize;
use serde_json::Value;

mod range;
pub mod schema;

pub use self::range::{InvalidSetting, Setting, above, above_to};
use self::schema::{Schema, json_of};

/// A part of the configuration with its own keys. [`settings!`](crate::settings) implements this trait.
pub trait Section {
    /// Checks every setting. `path` is the section's key, for example `learner.loss`, or empty for the whole tree.
    ///
    /// # Errors
    /// Returns the first invalid setting.
    fn validate_at(&self, path: &str) -> Result<(), InvalidSetting>;

    /// Returns what the section may hold, with the default and the documentation of each key.
    fn schema() -> Schema;
}

/// A section with a fixed place in the configuration.
pub trait Root: Section {
    /// Its key, empty for the whole tree.
    const KEY: &'static str;
}

impl<T: Section> Section for Option<T> {
    fn schema() -> Schema {
        T::schema()
    }

    fn validate_at(&self, path: &str) -> Result<(), InvalidSetting> {
        self.as_ref().map_or(Ok(()), |section| section.validate_at(path))
    }
}

/// Returns the key of a field in the section at `path`.
pub fn key(path: &str, field: &str) -> String {
    if path.is_empty() { field.to_owned() } else { format!("{path}.{field}") }
}

/// Returns a value as it would be written in a file, for error messages.
pub fn shown(value: &(impl Serialize + Debug)) -> String {
    fn text(value: &Value) -> String {
        match value {
            Value::Array(values) => format!("[{}]", values.iter().map(text).collect::<Vec<_>>().join(", ")),
            leaf => leaf.to_string(),
        }
    }
    // NaN and infinity have no JSON form.
    json_of(value).ok().filter(|value| !value.is_null()).map_or_else(|| format!("{value:?}"), |value| text(&value))
}

/// Defines sections of the configuration: types with serde derives, defaults, ranges, and checks.
///
/// A field is one of
/// - `pub name: Type = default;`
/// - `pub name: Type = default, in range;` for a [`Setting`](crate::setting::Setting) and its valid range,
/// - `pub name: Type = default, where |c| predicate => "what is expected";` for a rule about the section `c`, also
///   after `in`,
/// - `pub name: Section;` for a nested [`Section`](crate::setting::Section) or an `Option` of one.
///
/// The default and range are appended to the field's documentation. `struct Name in "key"` is the
/// [`Root`](crate::setting::Root) with that key, which [`Valid`](crate::Valid) checks. `struct Name, check method` calls `method(&self, path: &str)` last, for rules that the forms
/// above cannot express.
///
/// `enum Name = Variant { … }` is a choice by `kind`. The default is `Variant` with the defaults of its section. Each
/// variant has a section, if need be an empty one, because serde would ignore unknown keys of a variant without.
#[macro_export]
macro_rules! settings {
    () => {};
    (@check $self:ident $path:ident $field:ident) => {
        $crate::setting::Section::validate_at(&$self.$field, &$crate::setting::key($path, stringify!($field)))?;
    };
    (@check $self:ident $path:ident $field:ident
        = $default:expr $(, in $range:expr)? $(, where $rule:expr => $expected:literal)?
    ) => {
        $($crate::setting::Setting::check_in(
            &$self.$field,
            &$crate::setting::key($path, stringify!($field)),
            &$range,
        )?;)?
        $(
            let rule: fn(&Self) -> bool = $rule;
            $crate::InvalidSetting::check(
                $crate::setting::key($path, stringify!($field)),
                $crate::setting::shown(&$self.$field),
                rule($self),
                $expected,
            )?;
        )?
    };
    (@default) => { ::core::default::Default::default() };
    (@default $default:expr) => { $default };
    (@docs $([$($meta:tt)*])*) => { &[$($crate::settings!(@doc $($meta)*)),*] };
    (@doc doc = $line:literal) => { $line };
    (@doc $($other:tt)*) => { "" };
    (@schema $defaults:ident [$($docs:tt)*] $field:ident $type:ty) => {
        $crate::setting::schema::described(
            <$type as $crate::setting::Section>::schema(),
            $crate::settings!(@docs $($docs)*),
        )
    };
    (@schema $defaults:ident [$($docs:tt)*] $field:ident $type:ty
        = $default:expr $(, in $range:expr)? $(, where $rule:expr => $expected:literal)?
    ) => {{
        let rule: &[&str] = &[$($expected)?];
        let docs = $crate::settings!(@docs $($docs)*);
        let schema = $crate::setting::schema::value(docs, &$defaults.$field, rule.first().copied());
        $(let schema = $crate::setting::schema::within::<$type>(schema, &$range);)?
        schema
    }};
    (
        $(#[$($meta:tt)*])*
        $vis:vis struct $name:ident $(in $root:literal)? $(, check $check:ident)? {
            $(
                $(#[$($field_meta:tt)*])*
                $field_vis:vis $field:ident: $type:ty
                    $(= $default:expr $(, in $range:expr)? $(, where $rule:expr => $expected:literal)?)?;
            )*
        }
        $($rest:tt)*
    ) => {
        $(#[$($meta)*])*
        #[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        $vis struct $name {
            $(
                $(#[$($field_meta)*])*
                $(#[doc = concat!(
                    " Default `", stringify!($default), "`", $(", range `", stringify!($range), "`",)?
                    $(", ", $expected,)? "."
                )])?
                $field_vis $field: $type,
            )*
        }

        impl ::core::default::Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::settings!(@default $($default)?),)* }
            }
        }

        impl $crate::setting::Section for $name {
            #[allow(unused_variables, reason = "a section may be empty")]
            fn validate_at(&self, path: &str) -> ::core::result::Result<(), $crate::InvalidSetting> {
                $($crate::settings!(
                    @check self path $field $(= $default $(, in $range)? $(, where $rule => $expected)?)?
                );)*
                $(self.$check(path)?;)?
                Ok(())
            }

            #[allow(unused_variables, reason = "a section may be empty")]
            fn schema() -> $crate::setting::schema::Schema {
                let defaults = Self::default();
                $crate::setting::schema::section($crate::settings!(@docs $([$($meta)*])*), [$((
                    stringify!($field),
                    $crate::settings!(
                        @schema defaults [$([$($field_meta)*])*] $field $type
                            $(= $default $(, in $range)? $(, where $rule => $expected)?)?
                    ),
                ),)*])
            }
        }

        $(impl $crate::setting::Root for $name {
            const KEY: &'static str = $root;
        })?

        $crate::settings! { $($rest)* }
    };
    (
        $(#[$($meta:tt)*])*
        $vis:vis enum $name:ident = $default:ident {
            $($(#[$($variant_meta:tt)*])* $variant:ident($section:ty),)*
        }
        $($rest:tt)*
    ) => {
        $(#[$($meta)*])*
        #[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(tag = "kind", rename_all = "kebab-case")]
        $vis enum $name {
            $($(#[$($variant_meta)*])* $variant($section),)*
        }

        impl ::core::default::Default for $name {
            fn default() -> Self {
                Self::$default(::core::default::Default::default())
            }
        }

        impl $crate::setting::Section for $name {
            fn validate_at(&self, path: &str) -> ::core::result::Result<(), $crate::InvalidSetting> {
                match self {
                    $(Self::$variant(section) => <$section as $crate::setting::Section>::validate_at(section, path),)*
                }
            }

            fn schema() -> $crate::setting::schema::Schema {
                $crate::setting::schema::choice(
                    $crate::settings!(@docs $([$($meta)*])*),
                    stringify!($default),
                    [$((
                        stringify!($variant),
                        <$section as $crate::setting::Section>::schema(),
                        $crate::settings!(@docs $([$($variant_meta)*])*),
                    ),)*],
                )
            }
        }

        $crate::settings! { $($rest)* }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    crate::settings! {
        /// A section with every form of a field.
        struct Outer in "outer", check even {
            /// Number.
            n: usize = 2, in 1..=64;
            /// Numbers that share a range.
            rates: Vec<f32> = vec![0.5], in 0.0..1.0, where |c| !c.rates.is_empty() => "at least one";
            /// No range.
            name: String = "a".to_owned();
            /// May be absent.
            rate: Option<f64> = None, in above(0.0);
            /// A choice.
            choice: Choice;
            /// A section that may be absent.
            inner: Option<Inner>;
        }

        /// A choice.
        enum Choice = Some {
            /// Nothing.
            None(Empty),
            /// Something.
            Some(Inner),
        }

        /// A section without settings.
        struct Empty {}

        /// A section in a section.
        struct Inner {
            /// Number.
            weight: f32 = 1.0, in 0.0..;
        }
    }

    impl Outer {
        fn even(&self, path: &str) -> Result<(), InvalidSetting> {
            InvalidSetting::check(key(path, "n"), self.n, self.n.is_multiple_of(2), "an even number")
        }
    }

    #[test]
    fn the_defaults_are_valid_and_every_key_may_be_left_out() {
        let config = Outer::default();
        assert_eq!(config.validate_at(Outer::KEY), Ok(()));
        assert_eq!(serde_json::from_str::<Outer>("{}").unwrap(), config);
        assert_eq!((config.choice, config.inner), (Choice::Some(Inner { weight: 1.0 }), None));
        for unknown in
            [r#"{"m": 1}"#, r#"{"choice": {"kind": "none", "m": 1}}"#, r#"{"choice": {"kind": "some", "m": 1}}"#]
        {
            let error = serde_json::from_str::<Outer>(unknown).unwrap_err().to_string();
            assert!(error.contains("unknown field `m`"), "{error}");
        }
    }

    #[test]
    fn the_schema_says_what_the_macro_knows() {
        let schema = Outer::schema();
        assert_eq!(schema["description"], "A section with every form of a field.");
        assert_eq!(schema["additionalProperties"], false);
        let field = |name: &str| schema["properties"][name].to_string();
        for (name, expected) in [
            ("n", r#"{"default":2,"description":"Number.","maximum":64,"minimum":1,"type":"integer"}"#),
            ("name", r#"{"default":"a","description":"No range.","type":"string"}"#),
            ("rate", r#"{"default":null,"description":"May be absent.","exclusiveMinimum":0,"type":"number"}"#),
            (
                "rates",
                r#"{"$comment":"at least one","default":[0.5],"description":"Numbers that share a range.","items":{"exclusiveMaximum":1,"minimum":0,"type":"number"},"type":"array"}"#,
            ),
        ] {
            assert_eq!(field(name), expected);
        }
        let choice = &schema["properties"]["choice"];
        assert_eq!(choice["oneOf"][1]["properties"]["kind"]["const"], "some");
        assert_eq!(choice["oneOf"][1]["properties"]["weight"]["minimum"], 0);
        assert_eq!(choice["default"]["kind"], "some");
        assert_eq!(schema["properties"]["inner"]["properties"]["weight"]["description"], "Number.");
    }

    #[test]
    fn the_error_names_key_value_and_range() {
        type Spoil = fn(&mut Outer);
        let cases: [(Spoil, &str); 9] = [
            (|c| c.n = 0, "outer.n = 0: expected 1..=64"),
            (|c| c.n = 3, "outer.n = 3: expected an even number"),
            (|c| c.rates.push(1.0), "outer.rates = 1: expected at least 0 and below 1"),
            (|c| c.rates.push(f32::NAN), "outer.rates = NaN: expected at least 0 and below 1"),
            (|c| c.rates.clear(), "outer.rates = []: expected at least one"),
            (|c| c.rate = Some(0.0), "outer.rate = 0: expected above 0 and finite"),
            (|c| c.rate = Some(f64::INFINITY), "outer.rate = inf: expected above 0 and finite"),
            (|c| c.choice = Choice::Some(Inner { weight: -1.0 }), "outer.choice.weight = -1: expected at least 0"),
            (|c| c.inner = Some(Inner { weight: f32::NAN }), "outer.inner.weight = NaN: expected at least 0"),
        ];
        for (spoil, message) in cases {
            let mut config = Outer::default();
            spoil(&mut config);
            assert_eq!(config.validate_at(Outer::KEY).unwrap_err().to_string(), message);
        }
        let ids: Vec<blueprints::BlueprintId> = vec!["2_000".parse().unwrap(), "2_001".parse().unwrap()];
        assert_eq!(shown(&ids), r#"["2_000", "2_001"]"#);
        assert_eq!([shown(&0.1_f32), shown(&f32::NAN), shown(&"a")], ["0.1", "NaN", "\"a\""]);
        assert_eq!(Outer { choice: Choice::None(Empty {}), ..Default::default() }.validate_at("outer"), Ok(()));
    }
}
