//! A Unix socket. Its file mode controls who may connect, and no other file is ever removed.

use std::fs;
use std::io;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::task::{Context, Poll, ready};

use tokio::net::{UnixListener, UnixStream};

use crate::http::address::ListenError;

/// A bound socket; dropping it removes its file.
pub(crate) struct UnixSocket {
    listener: UnixListener,
    path: PathBuf,
    /// Device and inode of its file.
    file: (u64, u64),
}

impl UnixSocket {
    /// Binds the socket in a private folder, sets its mode, and then renames it: no client can connect before the
    /// mode is set, and the old name never points to nothing.
    pub(crate) fn bind(path: &Path, mode: u32) -> Result<Self, ListenError> {
        // The socket is bound under another name, so check here that `path` is short enough for clients: the system
        // allows some hundred bytes.
        std::os::unix::net::SocketAddr::from_pathname(path)?;
        remove_stale_socket(path)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // A short name, for the same reason.
        let hidden = folder.join(format!(".v{:x}", std::process::id()));
        let _ = fs::remove_dir_all(&hidden);
        fs::DirBuilder::new().create_private(&hidden)?;
        let bound = bind_within(&hidden, path, mode);
        let _ = fs::remove_dir_all(&hidden);
        let listener = bound?;
        let file = fs::symlink_metadata(path)?;
        Ok(Self { listener, path: path.to_owned(), file: (file.dev(), file.ino()) })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) const fn listener(&self) -> &UnixListener {
        &self.listener
    }

    pub(crate) fn poll_accept(&self, context: &mut Context<'_>) -> Poll<io::Result<UnixStream>> {
        Poll::Ready(ready!(self.listener.poll_accept(context)).map(|(stream, _)| stream))
    }
}

fn bind_within(hidden: &Path, path: &Path, mode: u32) -> io::Result<UnixListener> {
    let inner = hidden.join("s");
    let listener = UnixListener::bind(&inner)?;
    fs::set_permissions(&inner, fs::Permissions::from_mode(mode))?;
    fs::rename(&inner, path)?;
    Ok(listener)
}

/// Creates a folder that only its owner can access.
trait CreatePrivate {
    fn create_private(&mut self, path: &Path) -> io::Result<()>;
}

impl CreatePrivate for fs::DirBuilder {
    fn create_private(&mut self, path: &Path) -> io::Result<()> {
        std::os::unix::fs::DirBuilderExt::mode(self, 0o700);
        self.create(path)
    }
}

/// Checks that no foreign file is in the way. A socket on which no process answers belongs to a dead process.
fn remove_stale_socket(path: &Path) -> Result<(), ListenError> {
    let there = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        there => there?,
    };
    if !there.file_type().is_socket() {
        return Err(ListenError::NoSocket);
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => Err(ListenError::Answered),
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(()),
        // The state is unknown, perhaps for lack of permission; then the file must not be replaced.
        Err(error) => Err(error.into()),
    }
}

impl Drop for UnixSocket {
    fn drop(&mut self) {
        // Another process may have replaced the file in the meantime.
        let own = fs::symlink_metadata(&self.path).is_ok_and(|now| (now.dev(), now.ino()) == self.file);
        if own {
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn only_stale_sockets_are_replaced() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.sock");
        let mode = |path: &Path| fs::symlink_metadata(path).expect("there").permissions().mode() & 0o777;
        let first = UnixSocket::bind(&path, 0o660).expect("bound");
        assert_eq!(mode(&path), 0o660);
        assert!(matches!(UnixSocket::bind(&path, 0o600), Err(ListenError::Answered)));
        assert_eq!(mode(&path), 0o660, "untouched");
        drop(first);
        assert!(!path.exists(), "the file is removed");

        // As a killed process leaves it.
        drop(std::os::unix::net::UnixListener::bind(&path).expect("bound"));
        let second = UnixSocket::bind(&path, 0o600).expect("a stale socket is replaced");
        std::os::unix::net::UnixStream::connect(&path).expect("it answers");
        assert_eq!(mode(&path), 0o600);
        // A socket whose file was replaced does not remove the new file.
        fs::remove_file(&path).expect("removed");
        fs::write(&path, "a file").expect("written");
        drop(second);
        assert!(matches!(UnixSocket::bind(&path, 0o600), Err(ListenError::NoSocket)));
        assert_eq!(fs::read_to_string(&path).expect("still there"), "a file");
        let left: Vec<_> = fs::read_dir(folder.path()).expect("folder").collect();
        assert_eq!(left.len(), 1, "no temporary file is left: {left:?}");
    }
}
