//! Macros and traits of the settings tables: one line per setting, with unit, range, default and paper symbol.

use std::fmt::Display;

/// Why a setting was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// No such key.
    #[error("unknown setting `{key}`{hint}; `lumiscan config` lists every setting")]
    UnknownKey {
        /// The key.
        key: String,
        /// " (did you mean …?)" or empty.
        hint: String,
    },
    /// The value is of the wrong type or outside its range.
    #[error("setting `{key}` = {value}: must be {expected}")]
    BadValue {
        /// The key.
        key: String,
        /// The value given.
        value: String,
        /// What is allowed.
        expected: String,
    },
    /// The file is not TOML, or not laid out as one table per section.
    #[error("not a valid configuration: {0}")]
    Syntax(String),
}

/// One setting, as `lumiscan config` prints it.
#[derive(Debug, Clone, PartialEq)]
pub struct SettingInfo {
    /// "section.name".
    pub key: String,
    /// Current value, as TOML.
    pub value: String,
    /// Default value, as TOML.
    pub default: String,
    /// Unit, or empty.
    pub unit: &'static str,
    /// Allowed values.
    pub range: String,
    /// Symbol in the paper ("c1, Eq. (1)"), or empty.
    pub symbol: &'static str,
    /// Description.
    pub doc: &'static str,
    /// True for thresholds of a single stage: a scan stores them only where they differ from their default.
    pub tuning: bool,
}

/// A type a setting can have.
pub trait Value: Sized + Clone + PartialEq {
    /// What bounds it.
    type Range;
    /// Reads a TOML value; the error says what is expected.
    fn from_toml(value: &toml::Value, range: &Self::Range) -> Result<Self, String>;
    /// As a TOML literal.
    fn to_toml(&self) -> String;
    /// The range in words.
    fn describe(range: &Self::Range) -> String;
}

fn bounded<T: PartialOrd + Display + Copy>(x: T, range: &std::ops::RangeInclusive<T>) -> Result<T, String> {
    if range.contains(&x) { Ok(x) } else { Err(format!("from {} to {}", range.start(), range.end())) }
}

impl Value for f64 {
    type Range = std::ops::RangeInclusive<f64>;
    fn from_toml(value: &toml::Value, range: &Self::Range) -> Result<Self, String> {
        let x = match value {
            toml::Value::Float(x) => *x,
            toml::Value::Integer(i) => *i as f64,
            _ => return Err("a number".into()),
        };
        bounded(x, range)
    }
    fn to_toml(&self) -> String {
        format!("{self:?}")
    }
    fn describe(range: &Self::Range) -> String {
        format!("{} … {}", range.start(), range.end())
    }
}

impl Value for u32 {
    type Range = std::ops::RangeInclusive<u32>;
    fn from_toml(value: &toml::Value, range: &Self::Range) -> Result<Self, String> {
        let i = value.as_integer().ok_or("a whole number")?;
        let x = u32::try_from(i).map_err(|_| format!("from {} to {}", range.start(), range.end()))?;
        bounded(x, range)
    }
    fn to_toml(&self) -> String {
        self.to_string()
    }
    fn describe(range: &Self::Range) -> String {
        format!("{} … {}", range.start(), range.end())
    }
}

impl Value for bool {
    type Range = ();
    fn from_toml(value: &toml::Value, (): &()) -> Result<Self, String> {
        value.as_bool().ok_or_else(|| "true or false".into())
    }
    fn to_toml(&self) -> String {
        self.to_string()
    }
    fn describe((): &()) -> String {
        "true, false".into()
    }
}

impl Value for String {
    /// Most bytes.
    type Range = usize;
    fn from_toml(value: &toml::Value, most: &usize) -> Result<Self, String> {
        value.as_str().filter(|s| s.len() <= *most).map(Into::into).ok_or_else(|| Self::describe(most))
    }
    fn to_toml(&self) -> String {
        toml::Value::String(self.clone()).to_string()
    }
    fn describe(most: &usize) -> String {
        format!("text of at most {most} bytes")
    }
}

/// Declares an enum setting whose TOML form is its lower-case name.
macro_rules! choices {
    ($(#[$meta:meta])* $name:ident { $($(#[$vmeta:meta])* $variant:ident = $text:literal),+ $(,)? }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name { $($(#[$vmeta])* $variant),+ }
        impl $name {
            /// The name in the configuration file.
            #[must_use]
            pub fn as_str(&self) -> &'static str { match self { $(Self::$variant => $text),+ } }
        }
        impl $crate::settings::Value for $name {
            type Range = ();
            fn from_toml(value: &toml::Value, (): &()) -> Result<Self, String> {
                match value.as_str() { $(Some($text) => Ok(Self::$variant),)+ _ => Err(format!("one of {}", Self::describe(&()))) }
            }
            fn to_toml(&self) -> String { format!("{:?}", self.as_str()) }
            fn describe((): &()) -> String { [$($text),+].join(", ") }
        }
    };
}

/// Declares a section: a struct with one documented, bounded, defaulted field per setting, and optionally a field `tuning`
/// for the thresholds of its stages.
macro_rules! section {
    ($(#[$meta:meta])* $name:ident = $section:literal {
        $(#[doc = $doc:literal] $field:ident: $ty:ty = $default:expr, [$range:expr], $unit:literal, $symbol:literal;)+
    } $(with $tuning:ty)?) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $(#[doc = $doc] pub $field: $ty,)+
            $(/// Thresholds of the stages.
            pub tuning: $tuning,)?
        }
        impl Default for $name {
            fn default() -> Self { Self { $($field: $default,)+ $(tuning: <$tuning>::default(),)? } }
        }
        impl $name {
            /// Name of the section in the configuration file.
            pub const SECTION: &'static str = $section;
            /// Every setting of the section.
            #[must_use]
            pub fn settings(&self) -> Vec<$crate::settings::SettingInfo> {
                use $crate::settings::Value;
                let default = Self::default();
                vec![$($crate::settings::SettingInfo {
                    key: concat!($section, ".", stringify!($field)).into(),
                    value: self.$field.to_toml(),
                    default: default.$field.to_toml(),
                    unit: $unit,
                    range: <$ty as Value>::describe(&$range),
                    symbol: $symbol,
                    doc: $doc.trim(),
                    tuning: false,
                }),+]
            }
            /// Sets one field; `None` if there is no such field.
            pub fn set(&mut self, field: &str, value: &toml::Value) -> Option<Result<(), $crate::settings::ConfigError>> {
                use $crate::settings::Value;
                match field {
                    $(stringify!($field) => Some(match <$ty as Value>::from_toml(value, &$range) {
                        Ok(x) => { self.$field = x; Ok(()) }
                        Err(expected) => Err($crate::settings::ConfigError::BadValue {
                            key: concat!($section, ".", stringify!($field)).into(), value: value.to_string(), expected,
                        }),
                    }),)+
                    _ => None,
                }
            }
        }
    };
}

/// Declares a group of sections that hold thresholds.
macro_rules! tuning {
    ($(#[$meta:meta])* $name:ident { $(#[doc = $doc:literal] $section:ident: $ty:ident;)+ }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Default)]
        pub struct $name { $(#[doc = $doc] pub $section: $ty),+ }
        impl $name {
            /// Every setting of the group.
            #[must_use]
            pub fn settings(&self) -> Vec<$crate::settings::SettingInfo> {
                let mut all = [$(self.$section.settings()),+].concat();
                all.iter_mut().for_each(|s| s.tuning = true);
                all
            }
            /// Sets one field; `None` if there is no such section or field.
            pub fn set(
                &mut self, section: &str, field: &str, value: &toml::Value,
            ) -> Option<Result<(), $crate::settings::ConfigError>> {
                match section {
                    $($ty::SECTION => self.$section.set(field, value),)+
                    _ => None,
                }
            }
        }
    };
}

pub(crate) use {choices, section, tuning};
