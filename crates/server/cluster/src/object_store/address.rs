//! From a URL or a path to storage.

use std::path::Path;
use std::sync::Arc;

use object_store::ObjectStore;
use object_store::local::LocalFileSystem;
use url::Url;

use crate::ClusterError;

/// Storage, and where in it.
pub(crate) type Place = (Arc<dyn ObjectStore>, object_store::path::Path);

/// What a URL names; a path is a folder. With `make`, a folder is made where there is none.
pub(crate) fn place_of(url: &str, make: bool) -> Result<Place, ClusterError> {
    let wrong = |reason: String| ClusterError::StorageAddress { url: without_login(url), reason };
    if !url.contains("://") {
        return folder(Path::new(url), make);
    }
    let parsed = Url::parse(url).map_err(|error| wrong(format!("not a URL ({error}); give {FORMS}")))?;
    if !parsed.username().is_empty() || parsed.password().is_some() {
        return Err(wrong(
            "credentials do not belong into a URL, which ends up in logs; set them in the environment"
                .to_owned(),
        ));
    }
    if parsed.query().is_some() || parsed.fragment().is_some() {
        return Err(wrong(format!("nothing may follow the path; give {FORMS}")));
    }
    match parsed.scheme() {
        "file" => {
            let path = parsed.to_file_path();
            folder(
                &path.map_err(|()| wrong("a folder on another machine; give file:///PATH".to_owned()))?,
                make,
            )
        }
        "s3" | "gs" | "az" => cloud(&parsed).map_err(|error| match error {
            Some(source) => ClusterError::Storage { address: url.to_owned(), source: Box::new(source) },
            None => wrong(
                "this program was built without storage of clouds; build it with `--features clouds`"
                    .to_owned(),
            ),
        }),
        scheme => Err(wrong(format!("{scheme}:// is not known; give {FORMS}"))),
    }
}

/// What stands before an `@` of a URL is nobody's.
fn without_login(url: &str) -> String {
    match url.split_once("://").and_then(|(scheme, rest)| Some((scheme, rest.rsplit_once('@')?))) {
        Some((scheme, (_, rest))) => format!("{scheme}://{rest}"),
        None => url.to_owned(),
    }
}

const FORMS: &str = "a path, file:///PATH, s3://BUCKET/PATH, gs://BUCKET/PATH or az://CONTAINER/PATH";

fn folder(path: &Path, make: bool) -> Result<Place, ClusterError> {
    if make {
        std::fs::create_dir_all(path).map_err(ClusterError::io(path))?;
    }
    let metadata = std::fs::metadata(path).map_err(ClusterError::io(path))?;
    if !metadata.is_dir() {
        return Err(ClusterError::io(path)(std::io::Error::from(std::io::ErrorKind::NotADirectory)));
    }
    let store = LocalFileSystem::new_with_prefix(path).map_err(|source| ClusterError::Storage {
        address: path.display().to_string(),
        source: Box::new(source),
    })?;
    Ok((Arc::new(store.with_fsync(true)), object_store::path::Path::default()))
}

/// Settings and credentials are the environment's: those that the clouds' own programs read.
#[cfg(feature = "clouds")]
fn cloud(url: &Url) -> Result<Place, Option<object_store::Error>> {
    use object_store::aws::AmazonS3Builder;
    use object_store::azure::MicrosoftAzureBuilder;
    use object_store::gcp::GoogleCloudStorageBuilder;
    use object_store::{ClientOptions, RetryConfig, path};

    // Only the first provider counts; whoever set one before meant it.
    let _ = rustls::crypto::ring::default_provider().install_default();
    // A region takes as long as it takes; what stands still is noticed by whoever reads.
    let client = ClientOptions::new().with_timeout(LONGEST_REQUEST).with_allow_http(
        std::env::var("AWS_ALLOW_HTTP").is_ok_and(|v| v.eq_ignore_ascii_case("true") || v == "1"),
    );
    let location = path::Path::from_url_path(url.path()).map_err(object_store::Error::from)?;
    // Half a minute in all, with the attempts of our own around them: whoever starts meanwhile waits no longer.
    let retry = RetryConfig { max_retries: RETRIES, ..RetryConfig::default() };
    let store: Arc<dyn ObjectStore> = match url.scheme() {
        "s3" => Arc::new(
            AmazonS3Builder::from_env()
                .with_url(url.as_str())
                .with_client_options(client)
                .with_retry(retry)
                .build()?,
        ),
        "gs" => Arc::new(
            GoogleCloudStorageBuilder::from_env()
                .with_url(url.as_str())
                .with_client_options(client)
                .with_retry(retry)
                .build()?,
        ),
        _ => Arc::new(
            MicrosoftAzureBuilder::from_env()
                .with_url(url.as_str())
                .with_client_options(client)
                .with_retry(retry)
                .build()?,
        ),
    };
    Ok((store, location))
}

#[cfg(not(feature = "clouds"))]
const fn cloud(_: &Url) -> Result<Place, Option<object_store::Error>> {
    Err(None)
}

/// Of one request, after 0.1 s, then twice as long each time.
#[cfg(feature = "clouds")]
const RETRIES: usize = 6;

#[cfg(feature = "clouds")]
const LONGEST_REQUEST: std::time::Duration = std::time::Duration::from_secs(3600);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_names_no_storage_is_refused_with_what_does() {
        for (url, expected) in [
            ("http://example.com/maps", "s3://BUCKET"),
            ("ftp://example.com", "s3://BUCKET"),
            ("file://elsewhere/maps", "file:///PATH"),
            ("s3://key:secret@bucket/maps", "environment"),
            ("s3://bucket/maps?versionId=1", "nothing may follow"),
            ("://", "not a URL"),
            ("s3://key:secret@bu^cket:x/maps", "not a URL"),
        ] {
            let error = place_of(url, false).expect_err(url);
            assert!(
                matches!(error, ClusterError::StorageAddress { .. }) && error.to_string().contains(expected),
                "{error}"
            );
            assert!(!error.to_string().contains("secret"), "{error}");
        }
        #[cfg(not(feature = "clouds"))]
        for url in ["s3://bucket/maps", "gs://bucket", "az://container/maps"] {
            assert!(place_of(url, false).expect_err(url).to_string().contains("--features clouds"));
        }
    }

    #[test]
    fn a_folder_is_made_when_it_may_be() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a b/maps");
        let text = path.to_str().unwrap();
        assert!(matches!(place_of(text, false), Err(ClusterError::Io { .. })));
        place_of(text, true).unwrap();
        place_of(text, false).unwrap();
        place_of(Url::from_file_path(&path).unwrap().as_str(), false).unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(place_of(file.to_str().unwrap(), false), Err(ClusterError::Io { .. })));
    }
}
