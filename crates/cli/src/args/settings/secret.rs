//! Masks secrets in printed settings: passwords and keys in addresses.

/// Replaces a secret.
pub(super) const MASK: &str = "***";

/// Masks the secrets of a text. In an `address` everything that may be a secret is masked; in other texts only a login
/// before a host.
///
/// For each address of a comma-separated list this masks the password (`http://USER:PASSWORD@HOST`), or everything
/// before the `@` if there is no separate user, and the whole query string (`?key=…`).
pub(super) fn masked(text: &str, address: bool) -> String {
    let parts: Vec<String> = text.split(',').map(|part| masked_part(part, address)).collect();
    parts.join(",")
}

fn masked_part(part: &str, address: bool) -> String {
    let (scheme, rest) = match part.find("://") {
        Some(at) => part.split_at(at + 3),
        // A path may contain any character, and so may a text that is not an address.
        None if !address || part.trim_start().starts_with(['/', '.', '~']) => return part.to_owned(),
        None => ("", part),
    };
    let (rest, query) = match rest.split_once('?') {
        Some((rest, query)) if address && !query.is_empty() => (rest, format!("?{MASK}")),
        _ => (rest, String::new()),
    };
    // A file URL has no login, and its path may contain an `@`.
    let login = if scheme.trim_start() == "file://" { None } else { rest.rsplit_once('@') };
    match login {
        None if query.is_empty() => part.to_owned(),
        None => format!("{scheme}{rest}{query}"),
        Some((login, host)) => {
            let user = login.split_once(':').map_or_else(String::new, |(user, _)| format!("{user}:"));
            format!("{scheme}{user}{MASK}@{host}{query}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_secrets_of_addresses_are_masked() {
        for (address, shown) in [
            ("https://gateway:secret@host-0:4222", "https://gateway:***@host-0:4222"),
            (
                "http://a:secret@b:1, http://c:secret@d:2,http://e:3",
                "http://a:***@b:1, http://c:***@d:2,http://e:3",
            ),
            ("gateway:secret@host-0:4222", "gateway:***@host-0:4222"),
            ("http://secret@host", "http://***@host"),
            ("http://user:sec@ret/secret@host", "http://user:***@host"),
            ("s3://key:secret@bucket/maps", "s3://key:***@bucket/maps"),
            ("https://collector:4318/in?key=secret", "https://collector:4318/in?***"),
            ("https://me:secret@host/?key=secret", "https://me:***@host/?***"),
        ] {
            assert_eq!(masked(address, true), shown);
            assert_eq!(masked(shown, true), shown, "masking is idempotent");
        }
        for plain in [
            "http://a:4222,https://b:4222",
            "s3://bucket/maps",
            "/srv/maps@home:2",
            "./a:b@c",
            "file:///a/b:c@d",
            "",
        ] {
            assert_eq!(masked(plain, true), plain);
        }
        // In other texts only an unambiguous login is masked.
        for plain in ["lobby=/maps/a:b@c.vmap", "1.5,-2,3,0.25", "what?key"] {
            assert_eq!(masked(plain, false), plain);
        }
        assert_eq!(masked("x=https://me:secret@host?a", false), "x=https://me:***@host?a");
    }
}
