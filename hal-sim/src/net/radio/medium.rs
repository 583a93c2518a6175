//! All stations and the channels they share.

use rand_core::Rng;

use super::airtime::{Airtime, Channel};
use super::station::{Direction, Reach, Station};
use super::survey::Survey;
use super::{Radio, Setup};
use crate::world::uniform;

/// How long the counters of airtime gather before they take effect.
pub(crate) const WINDOW_US: u64 = 10_000;
/// How often stations look where they are.
pub(crate) const LOOK_PERIOD_US: u64 = 100_000;

/// See the [module](super). Times are microseconds from the beginning of the world.
#[derive(Debug)]
pub(crate) struct Medium {
    survey: Survey,
    stations: Vec<Station>,
    channels: Vec<Channel>,
    /// Stations with something to send.
    busy: Vec<u32>,
    /// Share of segments lost behind the air.
    behind: f32,
    looks: u64,
    seed: u64,
}

impl Medium {
    pub(crate) fn new(setup: &Setup, radio: Radio) -> Self {
        let survey = Survey::new(setup, radio);
        Self {
            channels: vec![Channel::default(); survey.channels.len()],
            survey,
            stations: Vec::new(),
            busy: Vec::new(),
            behind: setup.link.loss,
            looks: 0,
            seed: setup.seed,
        }
    }

    /// One more station; `number` is that of its robot among all of the fleet. Until its place is
    /// told it hears as well as everybody does where there are no access points.
    pub(crate) fn add(&mut self, number: u32) -> usize {
        let mut station = Station::new(number, &self.survey, self.seed);
        station.begin(&self.survey, self.behind);
        self.stations.push(station);
        self.stations.len() - 1
    }

    /// Tells where a station begins. Later it moves with [`Medium::look`].
    pub(crate) fn begin(&mut self, station: usize, place: (f32, f32)) {
        let station = &mut self.stations[station];
        station.place = Some(place);
        station.begin(&self.survey, self.behind);
    }

    /// Looks where all stations are and what they hear. `place` tells where; a station of which
    /// it does not know stays where it was. `changed` is told of stations that something reaches
    /// no longer, or again.
    pub(crate) fn look(
        &mut self,
        now_us: u64,
        mut place: impl FnMut(usize) -> Option<(f32, f32)>,
        mut changed: impl FnMut(usize, Reach),
    ) {
        self.looks += 1;
        for (index, station) in self.stations.iter_mut().enumerate() {
            if let Some(seen) = place(index) {
                let first = station.place.replace(seen).is_none();
                if first {
                    station.begin(&self.survey, self.behind);
                }
            }
            let before = station.reach;
            station.look(&self.survey, self.behind, now_us, self.looks);
            if station.reach != before {
                changed(index, station.reach);
            }
        }
    }

    /// Whether anything reaches a station.
    pub(crate) fn reach(&self, station: usize) -> Reach {
        self.stations[station].reach
    }

    /// How strong a station hears its access point, dBm.
    pub(crate) fn rssi_dbm(&self, station: usize) -> i8 {
        self.stations[station].rssi_dbm
    }

    /// Number of the access point of a station, while it has one.
    #[cfg(test)]
    pub(crate) fn access_point(&self, station: usize) -> usize {
        self.stations[station].point()
    }

    /// Share of segments of a station that are lost.
    pub(crate) fn loss(&self, station: usize) -> f32 {
        self.stations[station].quality.loss
    }

    /// Sends `len` bytes through the air; returns when they have all been sent.
    pub(crate) fn send(
        &mut self,
        station: usize,
        direction: Direction,
        len: usize,
        now_us: u64,
    ) -> u64 {
        let index = station as u32;
        let station = &mut self.stations[station];
        if !station.listed {
            station.listed = true;
            self.busy.push(index);
        }
        let channel = self.survey.channel_of(station.point());
        let airtime = station.quality.airtime_ns(len);
        let channel = &self.channels[channel];
        let over = station
            .flow(direction)
            .send(airtime, now_us * 1_000, channel);
        over.div_ceil(1_000)
    }

    /// Ends a window: what each channel saw of these stations.
    pub(crate) fn close_window(&mut self, now_us: u64, sums: &mut Vec<Airtime>) {
        sums.clear();
        sums.resize(self.channels.len(), Airtime::default());
        let (survey, stations) = (&self.survey, &mut self.stations);
        self.busy.retain(|&index| {
            let station = &mut stations[index as usize];
            let sum = &mut sums[survey.channel_of(station.point())];
            let up = station.up.close(now_us * 1_000, WINDOW_US * 1_000, sum);
            let down = station.down.close(now_us * 1_000, WINDOW_US * 1_000, sum);
            station.listed = up || down;
            station.listed
        });
    }

    /// Begins a window after one in which all stations of the fleet did what `sums` say.
    pub(crate) fn open_window(&mut self, sums: &[Airtime]) {
        let contention = self.survey.figures.contention;
        for (channel, sum) in self.channels.iter_mut().zip(sums) {
            channel.open(*sum, WINDOW_US * 1_000, contention);
        }
    }

    /// Draws how long a segment waits for a sleeping radio, microseconds.
    pub(crate) fn spike(&self, rng: &mut impl Rng) -> u64 {
        let figures = &self.survey.figures;
        if figures.spike_share <= 0.0 || uniform(rng) >= figures.spike_share {
            return 0;
        }
        (figures.spike_ms * uniform(rng) * 1_000.0) as u64
    }
}
