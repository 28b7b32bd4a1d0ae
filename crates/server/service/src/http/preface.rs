//! Which HTTP is spoken on a plain connection: HTTP/2 begins with a preface that is no request of HTTP/1.1 (RFC 9113, 3.4).

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, ReadBuf};

const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// A stream some of whose bytes were read already, and are read again.
pub(crate) struct Rewound<S> {
    read: Vec<u8>,
    stream: S,
}

impl<S> Rewound<S> {
    /// Nothing was read yet.
    pub(crate) const fn fresh(stream: S) -> Self {
        Self { read: Vec::new(), stream }
    }
}

impl<S: AsyncRead + Unpin> Rewound<S> {
    /// Reads until it is clear whether this is HTTP/2. A connection that ends before that is not.
    pub(crate) async fn is_http2(&mut self) -> io::Result<bool> {
        while self.read.len() < PREFACE.len() && PREFACE.starts_with(&self.read) {
            let mut more = [0; PREFACE.len()];
            let wanted = PREFACE.len() - self.read.len();
            let count = self.stream.read(&mut more[..wanted]).await?;
            if count == 0 {
                break;
            }
            self.read.extend(&more[..count]);
        }
        Ok(self.read == PREFACE)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Rewound<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.read.is_empty() {
            return Pin::new(&mut self.stream).poll_read(context, buffer);
        }
        let count = self.read.len().min(buffer.remaining());
        buffer.put_slice(&self.read[..count]);
        self.read.drain(..count);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Rewound<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_preface_is_known_however_it_comes_and_nothing_is_lost() {
        for (bytes, is_http2) in [
            (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\nmore".as_slice(), true),
            (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r", false),
            (b"PRI * HTTP/1.1\r\n\r\nSM\r\n\r\n", false),
            (b"POST / HTTP/1.1\r\n\r\n", false),
            (b"GET", false),
            (b"", false),
        ] {
            for step in [1, 7, 100] {
                let (mut client, server) = tokio::io::duplex(step);
                let sent = bytes.to_vec();
                let sending = tokio::spawn(async move {
                    tokio::io::AsyncWriteExt::write_all(&mut client, &sent).await.expect("written");
                });
                let mut stream = Rewound::fresh(server);
                assert_eq!(stream.is_http2().await.expect("read"), is_http2, "{bytes:?}");
                let mut all = Vec::new();
                stream.read_to_end(&mut all).await.expect("read");
                assert_eq!(all, bytes);
                sending.await.expect("sent");
            }
        }
    }
}
