//! TCP port of a virtual finger, for one host after the other.

use std::io;
use std::net::{TcpListener, ToSocketAddrs};

use embedded_io_adapters::tokio_1::FromTokio;
use taxel::instrument::Instrument;
use taxel::session::{Buffers, End, Pace, run_session};

use super::board::PacedBoard;
use super::{BACKLOG, idle};

pub(super) fn listen(address: impl ToSocketAddrs) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    // Accepted sockets inherit this size.
    socket2::SockRef::from(&listener).set_send_buffer_size(BACKLOG)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves hosts until the scans end.
pub(super) async fn serve(
    listener: TcpListener,
    board: &mut PacedBoard,
    instrument: &mut Instrument,
) -> io::Result<()> {
    let listener = tokio::net::TcpListener::from_std(listener)?;
    loop {
        let mut stream = tokio::select! {
            accepted = listener.accept() => accepted?.0,
            () = idle(board, instrument) => return Ok(()),
        };
        stream.set_nodelay(true)?;
        let (rx, tx) = stream.split();
        let rx = FromTokio::new(rx);
        let tx = FromTokio::new(tx);
        // A host that leaves with an error does not stop the next one.
        if let Ok(End::Scans) =
            run_session(rx, tx, board, instrument, &mut Buffers::new(), Pace::Live).await
        {
            return Ok(());
        }
    }
}
