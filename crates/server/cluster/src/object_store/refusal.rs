//! What storage of a cloud means by a refusal, and what to do about it.

use object_store::Error;

/// What to do about what storage reported, for the place that an address names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Refusal {
    /// In the words of whoever runs this program.
    pub(crate) why: &'static str,
    /// Settings to look at, and more.
    pub(crate) remedy: &'static str,
    /// In the storage's words.
    pub(crate) reported: String,
}

/// Why storage refused, where that is known and the same would be refused again; `address` says of which kind it is.
pub(crate) fn refusal_of(address: &str, error: &Error) -> Option<Refusal> {
    let text = error.to_string();
    let (code, message) = (element(&text, "Code"), element(&text, "Message"));
    // What Google says of it has no code of its own.
    let no_bucket = ["NoSuchBucket", "ContainerNotFound", "The specified bucket does not exist"];
    let region = ("the bucket is in another region", "set AWS_REGION to it");
    let (why, remedy) = match code {
        _ if no_bucket.iter().any(|known| text.contains(known)) => {
            ("there is no such bucket", "make it, or look at its name in the URL")
        }
        Some("InvalidAccessKeyId") => (
            "the key is not known there",
            "look at AWS_ACCESS_KEY_ID, and at AWS_ENDPOINT where this is not Amazon's storage",
        ),
        Some("SignatureDoesNotMatch") => {
            ("the secret does not belong to the key", "look at AWS_SECRET_ACCESS_KEY")
        }
        Some("ExpiredToken" | "InvalidToken" | "TokenRefreshRequired") => {
            ("the credentials have ended", "get new ones (AWS_SESSION_TOKEN among them)")
        }
        Some("RequestTimeTooSkewed") => ("the clock of this machine is wrong", "set it"),
        Some("AuthorizationHeaderMalformed" | "PermanentRedirect") => region,
        _ if text.contains("incorrectly configured region") => region,
        _ if matches!(error, Error::PermissionDenied { .. } | Error::Unauthenticated { .. }) => {
            ("the storage refuses these credentials here", credentials(address))
        }
        _ => return None,
    };
    let reported = match (code, message) {
        (Some(code), Some(message)) => format!("{code}: {message}"),
        // A reader of one line is not helped by a document.
        _ => text.lines().next().unwrap_or_default().to_owned(),
    };
    Some(Refusal { why, remedy, reported })
}

/// What stands in the first element of this name.
fn element<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(&format!("<{name}>"))?;
    Some(rest.split_once(&format!("</{name}>"))?.0)
}

/// Where credentials come from, and what they must be good for.
fn credentials(address: &str) -> &'static str {
    match address.split("://").next() {
        Some("gs") => {
            "look at GOOGLE_SERVICE_ACCOUNT, and whether it may read there (to publish: write and list, too)"
        }
        Some("az") => {
            "look at AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY, and whether they may read there (to publish: \
             write and list, too)"
        }
        _ => {
            "look at AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and whether they may read there (to publish: write and list, too)"
        }
    }
}

/// What may help where storage of a cloud was not reached, or not understood.
pub(crate) fn hint_of(address: &str, error: &Error) -> &'static str {
    let Error::Generic { .. } = error else { return "" };
    let reported = error.to_string();
    // Who finds no credentials asks the machine's own cloud for them.
    let asks_its_cloud = ["/latest/api/token", "/latest/meta-data", "metadata.google", "/metadata/identity"];
    match address.split("://").next() {
        Some("s3") if asks_its_cloud.iter().any(|known| reported.contains(known)) => {
            "; no credentials were found: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        }
        Some("s3") => "; look whether the storage answers there (AWS_ENDPOINT, AWS_REGION), and try again",
        Some("gs" | "az") if asks_its_cloud.iter().any(|known| reported.contains(known)) => {
            "; no credentials were found: set those of the cloud in the environment (GOOGLE_…, AZURE_…)"
        }
        Some("gs" | "az") => "; look whether the storage answers there, and try again",
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
    fn a_refusal_names_the_setting_that_is_wrong() {
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
    fn who_has_no_credentials_is_told_so() {
        let hint = |address: &str, body: &str| hint_of(address, &reported(body));
        assert!(
            hint("s3://maps", "PUT http://169.254.169.254/latest/api/token: timed out")
                .contains("AWS_ACCESS_KEY_ID")
        );
        assert!(hint("s3://maps", "connection refused").contains("AWS_ENDPOINT"));
        assert_eq!(hint("/srv/maps", "input/output error"), "");
    }
}
