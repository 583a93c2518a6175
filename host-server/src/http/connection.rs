//! An answer whose client has to take it: while it does not, its connection makes room for others.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use axum::response::Response;
use hyper::body::{Frame, SizeHint};

use crate::waiting::Slot;

/// The same answer. From now on the connection in `slot` waits for its client, and anew with each piece
/// of the answer that goes out.
pub(super) fn awaited(response: Response, slot: Arc<Slot>) -> Response {
    slot.wait();
    if response.body().is_end_stream() {
        return response;
    }
    response.map(|body| Body::new(Awaited { body, slot }))
}

struct Awaited {
    body: Body,
    slot: Arc<Slot>,
}

impl HttpBody for Awaited {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let frame = Pin::new(&mut self.body).poll_frame(context);
        if frame.is_ready() {
            self.slot.wait();
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
