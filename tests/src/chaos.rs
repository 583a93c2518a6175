//! A server, its broker and its robots as real processes, and everything between them going wrong.
//!
//! `terracrawler serve` and `terracrawler sim` run beside this process, and robots reach their broker
//! through the bad network of the simulator ([`crawler_sim::net::proxy`]): jitter, words that are sent
//! again, partitions, cut connections. Meanwhile somebody gives commands over HTTP and writes down
//! every 202, and somebody else sends commands to robots a second time. Processes are killed with
//! SIGKILL and started again.
//!
//! What robots really did is read from the recording of the simulation: every message at a robot's
//! end, every duty of its wheels and, by the program's own count, how many commands it carried out.
//! So nothing that the server says of itself is believed.

mod judge;
mod observed;
mod people;
mod report;
mod run;
mod twice;

pub use judge::{Given, Kind, judge};
pub use observed::{Answer, Delivery, Duty, Observations, Observed};
pub use report::{Fault, Report};
pub use run::{Broker, Options, run};
