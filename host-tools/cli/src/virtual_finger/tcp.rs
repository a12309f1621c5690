//! TCP port of a virtual finger, for one host after the other.

use std::io;
use std::net::{TcpListener, ToSocketAddrs};

use embedded_io_adapters::tokio_1::FromTokio;
use taxel::instrument::Instrument;
use taxel::session::{Buffers, End, Pace, run_session};
use tokio::io::AsyncReadExt;

use super::board::PacedBoard;
use super::hosts::{Host, Hosts};
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
    let mut hosts = Hosts::new(listener)?;
    loop {
        let Host { mut stream, request, .. } = tokio::select! {
            host = hosts.next() => host?,
            () = idle(board, instrument) => return Ok(()),
        };
        let (rx, tx) = stream.split();
        let rx = FromTokio::new(request.as_slice().chain(rx));
        let tx = FromTokio::new(tx);
        let mut buffers = Buffers::new();
        let ended = tokio::select! {
            biased;
            ended = run_session(rx, tx, board, instrument, &mut buffers, Pace::Live) => ended,
            never = hosts.refuse() => match never {},
        };
        // A host that leaves with an error does not stop the next one.
        if let Ok(End::Scans) = ended {
            return Ok(());
        }
    }
}
