//! A count that is 1 where a file does not say it, and that is not written then.

/// For serde's `default`.
pub fn one<T: From<u8>>() -> T {
    T::from(1)
}

/// For serde's `skip_serializing_if`.
pub fn is_one<T: From<u8> + PartialEq>(count: &T) -> bool {
    *count == one()
}
