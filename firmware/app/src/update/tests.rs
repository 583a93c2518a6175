//! Updates from offer to outcome: the transfer alone, and the whole program on a flash that takes time and loses its
//! power.

mod cuts;
mod deltas;
mod life;
mod refusals;
mod releases;
mod transfers;
mod whole;
