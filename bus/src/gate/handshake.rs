//! The four messages that begin a session of zenoh, as the gate sees them pass.

use std::io;
use std::path::Path;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;
use zenoh_codec::{RCodec, Zenoh080};
use zenoh_protocol::common::{ZExtBody, ZExtUnknown, iext};
use zenoh_protocol::transport::{TransportBody, TransportMessage};

use super::arrival::{Arrived, Refused};

/// Number of zenoh's extension in which a client names its user and proves the password.
const USER_PASSWORD: u8 = 0x2;

/// Leads a process to zenoh's router, which asks for its password, and returns the connection to the router.
///
/// The router's access rules know the user name alone. So the name must be the one in the certificate.
pub(super) async fn enter(arrived: &mut Arrived, router: &Path) -> Result<UnixStream, Refused> {
    let Arrived { stream, role, .. } = arrived;
    let mut inner = UnixStream::connect(router).await?;
    inner.write_all(&read_batch(stream).await?).await?;
    stream.write_all(&read_batch(&mut inner).await?).await?;
    stream.flush().await?;
    let proof = read_batch(stream).await?;
    if user(&proof).as_deref() != Some(role.as_bytes()) {
        return Err(Refused::Mixed { role: role.clone() });
    }
    inner.write_all(&proof).await?;
    let answer = read_batch(&mut inner).await?;
    stream.write_all(&answer).await?;
    stream.flush().await?;
    match message(&answer) {
        Some(TransportBody::OpenAck(_)) => Ok(inner),
        _ => Err(Refused::ByRouter { role: role.clone() }),
    }
}

/// Reads a batch with the two bytes of its length, as zenoh sends it over any stream.
async fn read_batch(stream: &mut (impl AsyncReadExt + Unpin)) -> io::Result<Vec<u8>> {
    let mut batch = vec![0; 2];
    stream.read_exact(&mut batch).await?;
    let length = u16::from_le_bytes([batch[0], batch[1]]);
    batch.resize(2 + usize::from(length), 0);
    stream.read_exact(&mut batch[2..]).await?;
    Ok(batch)
}

/// The first message of a batch, which is the one that zenoh reads while a session begins.
fn message(batch: &[u8]) -> Option<TransportBody> {
    let mut content = batch.get(2..)?;
    let message: TransportMessage = Zenoh080::new().read(&mut content).ok()?;
    Some(message.body)
}

/// The user name in a client's second message.
fn user(batch: &[u8]) -> Option<Vec<u8>> {
    let Some(TransportBody::OpenSyn(open)) = message(batch) else { return None };
    let codec = Zenoh080::new();
    let proofs = open.ext_auth?.value.to_zslice();
    let extensions: Vec<ZExtUnknown> = codec.read(&mut &*proofs).ok()?;
    let proof = extensions.into_iter().find(|extension| extension.id & iext::ID_MASK == USER_PASSWORD)?;
    let ZExtBody::ZBuf(content) = proof.body else { return None };
    codec.read(&mut &*content.to_zslice()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_batch_has_its_length_in_front() {
        let mut stream: &[u8] = &[3, 0, 7, 8, 9, 1, 0];
        assert_eq!(read_batch(&mut stream).await.unwrap(), [3, 0, 7, 8, 9]);
        assert_eq!(read_batch(&mut stream).await.unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }

    #[test]
    fn nonsense_names_no_user() {
        for batch in [&[][..], &[0], &[0, 0], &[1, 0, 255], &[4, 0, 2, 2, 2, 2]] {
            assert_eq!(user(batch), None, "{batch:?}");
        }
    }
}
