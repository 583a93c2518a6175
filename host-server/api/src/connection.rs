//! A request that has to come to its end, and an answer that has to be taken: while the client lets wait for
//! either, its connection makes room for others.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use axum::http::Request;
use axum::response::Response;
use hyper::body::{Frame, Incoming, SizeHint};

use crawler_system::waiting::Slot;

/// The same request. Once the whole of it has arrived, the connection in `slot` waits for its client no more.
pub(super) fn arriving(request: Request<Incoming>, slot: Arc<Slot>) -> Request<Arriving> {
    if request.body().is_end_stream() {
        slot.settle();
    }
    request.map(|body| Arriving { body, slot })
}

pub(super) struct Arriving {
    body: Incoming,
    slot: Arc<Slot>,
}

impl HttpBody for Arriving {
    type Data = Bytes;
    type Error = hyper::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, hyper::Error>>> {
        let frame = Pin::new(&mut self.body).poll_frame(context);
        // A body whose length is not told ends with nothing.
        let ended = matches!(frame, Poll::Ready(None));
        if ended || frame.is_ready() && self.body.is_end_stream() {
            self.slot.settle();
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
