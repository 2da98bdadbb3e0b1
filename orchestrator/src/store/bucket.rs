//! A folder of a bucket: S3 and what speaks its protocol, Google Cloud Storage, Azure.
//!
//! Credentials, region and endpoint come from the variables that the providers' own tools read (`AWS_ACCESS_KEY_ID`,
//! `AWS_ENDPOINT`, `GOOGLE_APPLICATION_CREDENTIALS`, `AZURE_STORAGE_ACCOUNT_NAME`, ...). A file is sent and fetched in parts,
//! one in memory at a time, so no request takes long.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use anyhow::{Context, Result};
use object_store::{Error, MultipartUpload, ObjectStore, ObjectStoreExt, path::Path as ObjectPath};
use tokio::runtime::{Builder, Runtime};
use url::Url;

/// Bytes of a part. S3 takes no parts but the last below 5 MiB, and no more than 10,000.
const PART: usize = 8 << 20;

/// How the names of variables begin that say how to reach a bucket.
const VARIABLES: [&str; 3] = ["AWS_", "AZURE_", "GOOGLE_"];

/// A folder of a bucket.
#[derive(Debug)]
pub(super) struct Bucket {
    objects: Box<dyn ObjectStore>,
    folder: ObjectPath,
    runtime: Runtime,
}

impl Bucket {
    /// The folder at an address such as `s3://BUCKET/FOLDER`.
    ///
    /// # Errors
    /// When the address is none of a bucket, or a variable has a value that cannot be used.
    pub(super) fn open(address: &str) -> Result<Self> {
        let failed = || {
            format!(
                "cannot use the store {address}: it is a folder, file:///PATH, s3://BUCKET/FOLDER, gs://BUCKET/FOLDER or \
                 az://CONTAINER/FOLDER"
            )
        };
        let url = Url::parse(address).with_context(failed)?;
        // The first call decides for the process; another one has decided the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let variables = std::env::vars_os().filter_map(|(name, value)| {
            let name = name.into_string().ok()?;
            let is_ours = VARIABLES.iter().any(|prefix| name.starts_with(prefix));
            is_ours.then_some((name, value.into_string().ok()?))
        });
        let (objects, folder) =
            object_store::parse_url_opts(&url, variables).with_context(failed)?;
        let runtime = Builder::new_current_thread().enable_all().build().with_context(failed)?;
        Ok(Self { objects, folder, runtime })
    }

    fn path(&self, name: &str) -> ObjectPath {
        self.folder.clone().join(name)
    }

    /// The size of a file; `None` when there is none.
    pub(super) fn size(&self, name: &str) -> Result<Option<u64>> {
        match self.runtime.block_on(self.objects.head(&self.path(name))) {
            Ok(facts) => Ok(Some(facts.size)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Sends `file`. It is there under its name only when all of it is.
    pub(super) fn put(&self, name: &str, file: &Path) -> Result<()> {
        let mut file = File::open(file)?;
        self.runtime.block_on(async {
            let mut upload = self.objects.put_multipart(&self.path(name)).await?;
            let sent = send(&mut file, &mut *upload).await;
            if sent.is_err() {
                // What is left of it costs space; the first error says what is wrong.
                let _ = upload.abort().await;
            }
            sent
        })
    }

    /// Writes the file `name` into `to`.
    pub(super) fn get(&self, name: &str, to: &mut File) -> Result<()> {
        let path = self.path(name);
        self.runtime.block_on(async {
            let size = self.objects.head(&path).await?.size;
            for start in (0..size).step_by(PART) {
                let end = size.min(start + PART as u64);
                to.write_all(&self.objects.get_range(&path, start..end).await?)?;
            }
            Ok(())
        })
    }
}

/// Sends all parts of `file`.
async fn send(file: &mut File, upload: &mut dyn MultipartUpload) -> Result<()> {
    loop {
        let mut part = Vec::with_capacity(PART);
        if Read::by_ref(file).take(PART as u64).read_to_end(&mut part)? == 0 {
            break;
        }
        upload.put_part(part.into()).await?;
    }
    upload.complete().await?;
    Ok(())
}
