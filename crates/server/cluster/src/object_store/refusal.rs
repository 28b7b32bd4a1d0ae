//! Classifies refusals of cloud storage, with remedies.

use object_store::Error;

/// A refusal, and the remedy for the storage that the address names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Refusal {
    /// The reason, in terms of this program.
    pub(crate) why: &'static str,
    /// The remedy, with settings to check.
    pub(crate) remedy: &'static str,
    /// The error as reported by the storage.
    pub(crate) reported: String,
}

/// Classifies a permanent refusal; `address` tells the kind of storage.
pub(crate) fn refusal_of(address: &str, error: &Error) -> Option<Refusal> {
    let text = error.to_string();
    let (code, message) = (element(&text, "Code"), element(&text, "Message"));
    // Google reports this without an error code.
    let no_bucket = ["NoSuchBucket", "ContainerNotFound", "The specified bucket does not exist"];
    let region = ("the bucket is in another region", "set AWS_REGION to it");
    let (why, remedy) = match code {
        _ if no_bucket.iter().any(|known| text.contains(known)) => {
            ("there is no such bucket", "create it, or check its name in the URL")
        }
        Some("InvalidAccessKeyId") => (
            "the storage does not know the key",
            "check AWS_ACCESS_KEY_ID, and AWS_ENDPOINT if this is not Amazon's storage",
        ),
        Some("SignatureDoesNotMatch") => {
            ("the secret does not belong to the key", "check AWS_SECRET_ACCESS_KEY")
        }
        Some("ExpiredToken" | "InvalidToken" | "TokenRefreshRequired") => {
            ("the credentials have expired", "get new ones, including AWS_SESSION_TOKEN")
        }
        Some("RequestTimeTooSkewed") => ("the clock of this machine is wrong", "set it"),
        Some("AuthorizationHeaderMalformed" | "PermanentRedirect") => region,
        _ if text.contains("incorrectly configured region") => region,
        _ if matches!(error, Error::PermissionDenied { .. } | Error::Unauthenticated { .. }) => {
            ("the storage refuses these credentials", credentials(address))
        }
        _ => return None,
    };
    let reported = match (code, message) {
        (Some(code), Some(message)) => format!("{code}: {message}"),
        // The message must be one line, not a document.
        _ => text.lines().next().unwrap_or_default().to_owned(),
    };
    Some(Refusal { why, remedy, reported })
}

/// Text of the first XML element of this name.
fn element<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(&format!("<{name}>"))?;
    Some(rest.split_once(&format!("</{name}>"))?.0)
}

/// Remedy for wrong credentials.
fn credentials(address: &str) -> &'static str {
    match address.split("://").next() {
        Some("gs") => {
            "check GOOGLE_SERVICE_ACCOUNT, and that it may read there (to publish: also write and list)"
        }
        Some("az") => {
            "check AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY, and that they may read there (to publish: also \
             write and list)"
        }
        _ => {
            "check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and that they may read there (to publish: also write and list)"
        }
    }
}

/// Hint if cloud storage was not reached or gave an unknown error.
pub(crate) fn hint_of(address: &str, error: &Error) -> &'static str {
    let Error::Generic { .. } = error else { return "" };
    let reported = error.to_string();
    // Without credentials, the library queries the metadata service of the cloud.
    let metadata_services =
        ["/latest/api/token", "/latest/meta-data", "metadata.google", "/metadata/identity"];
    match address.split("://").next() {
        Some("s3") if metadata_services.iter().any(|known| reported.contains(known)) => {
            "; no credentials were found: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        }
        Some("s3") => "; check that the storage answers there (AWS_ENDPOINT, AWS_REGION), and try again",
        Some("gs" | "az") if metadata_services.iter().any(|known| reported.contains(known)) => {
            "; no credentials were found: set those of the cloud in the environment (GOOGLE_…, AZURE_…)"
        }
        Some("gs" | "az") => "; check that the storage answers there, and try again",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reported(body: &str) -> Error {
        Error::Generic { store: "S3", source: body.to_owned().into() }
    }

    #[test]
    fn refusal_names_the_wrong_setting() {
        let s3 = "s3://maps/town/town.json";
        for (body, remedy) in [
            (
                "403: <Error><Code>InvalidAccessKeyId</Code><Message>No such key.</Message></Error>",
                "AWS_ACCESS_KEY_ID",
            ),
            ("403: <Error><Code>SignatureDoesNotMatch</Code></Error>", "AWS_SECRET_ACCESS_KEY"),
            ("400: <Error><Code>ExpiredToken</Code></Error>", "AWS_SESSION_TOKEN"),
            ("400: <Error><Code>AuthorizationHeaderMalformed</Code></Error>", "AWS_REGION"),
            ("403: <Error><Code>RequestTimeTooSkewed</Code></Error>", "set it"),
            ("404: <Error><Code>NoSuchBucket</Code></Error>", "name in the URL"),
        ] {
            let refusal = refusal_of(s3, &reported(body)).expect(body);
            assert!(refusal.remedy.contains(remedy), "{body}: {refusal:?}");
            assert!(
                !body.contains("Message") || refusal.reported == "InvalidAccessKeyId: No such key.",
                "{refusal:?}"
            );
        }
        let denied = Error::PermissionDenied { path: String::new(), source: "403".into() };
        for (address, setting) in
            [(s3, "AWS_ACCESS_KEY_ID"), ("gs://maps", "GOOGLE_"), ("az://maps", "AZURE_STORAGE_ACCOUNT_KEY")]
        {
            assert!(refusal_of(address, &denied).expect("known").remedy.contains(setting), "{address}");
        }
        for passes in ["503: <Error><Code>SlowDown</Code></Error>", "500", "connection reset"] {
            assert_eq!(refusal_of(s3, &reported(passes)), None, "{passes}");
        }
    }

    #[test]
    fn missing_credentials_give_a_hint() {
        let hint = |address: &str, body: &str| hint_of(address, &reported(body));
        assert!(
            hint("s3://maps", "PUT http://169.254.169.254/latest/api/token: timed out")
                .contains("AWS_ACCESS_KEY_ID")
        );
        assert!(hint("s3://maps", "connection refused").contains("AWS_ENDPOINT"));
        assert_eq!(hint("/srv/maps", "input/output error"), "");
    }
}
