use super::*;

/// Something is due that often.
const CONTROL: Duration = Duration::from_millis(20);
/// Least rest between two turns.
const REST: Duration = Duration::from_millis(2);

/// A world on a machine that needs a share of real time for each unit of virtual time.
struct Machine {
    pacer: Pacer,
    real: Instant,
    reached: Instant,
    paces: Vec<Pace>,
}

impl Machine {
    fn new() -> Self {
        Self {
            pacer: Pacer::new(),
            real: Instant::BOOT,
            reached: Instant::BOOT,
            paces: Vec::new(),
        }
    }

    fn turn(&mut self, percent: u64) {
        let steps = self.reached.as_micros() / CONTROL.as_micros() + 1;
        let due = Instant::from_micros(steps * CONTROL.as_micros());
        let target = self.pacer.target(self.real, self.reached, due);
        assert!(target >= self.reached, "time goes back");
        assert!(target <= self.real, "ahead of real time");
        let burst = target - self.reached;
        assert!(burst <= MAX_BATCH, "{burst:?} at once");
        self.reached = target;
        self.real += Duration::from_micros(burst.as_micros() * percent / 100);
        self.paces
            .extend(self.pacer.measure(self.real, self.reached));
        self.real += REST;
    }

    fn run(&mut self, seconds: u64, percent: u64) {
        let end = self.real + Duration::from_secs(seconds);
        while self.real < end {
            self.turn(percent);
        }
    }

    fn last(&self) -> Pace {
        *self.paces.last().expect("a window has passed")
    }
}

#[test]
fn a_machine_that_keeps_up_runs_in_real_time_and_loses_nothing() {
    let mut machine = Machine::new();
    machine.run(10, 50);
    assert!(machine.paces.len() >= 9);
    for pace in &machine.paces {
        assert!((pace.factor - 1.0).abs() < 0.01, "{pace:?}");
        assert!(pace.lateness < Duration::from_millis(10), "{pace:?}");
        assert_eq!(pace.lost, Duration::from_micros(0));
    }
}

#[test]
fn overload_slows_time_down_and_does_not_spiral() {
    let mut machine = Machine::new();
    machine.run(60, 300);
    // A turn of 100 ms takes 300 ms and the rest.
    for pace in &machine.paces[1..] {
        assert!((pace.factor - 0.331).abs() < 0.01, "{pace:?}");
        assert!(pace.lateness > Duration::from_millis(200), "{pace:?}");
        assert!(pace.lateness < Duration::from_millis(310), "{pace:?}");
    }
    assert!(
        machine
            .paces
            .windows(2)
            .all(|two| two[0].lost < two[1].lost)
    );
    // What did not run was given up, but for what the last turn took.
    let missing = machine.real - machine.reached;
    assert!(missing.saturating_sub(machine.last().lost) < Duration::from_secs(1));
    assert!(machine.last().lost > Duration::from_secs(39));
}

#[test]
fn what_was_given_up_is_not_made_up_for_later() {
    let mut machine = Machine::new();
    machine.run(10, 300);
    let (real, reached) = (machine.real, machine.reached);
    machine.run(10, 10);
    let passed = (machine.reached - reached).as_micros() as f64;
    let span = (machine.real - real).as_micros() as f64;
    // At most one batch of the past, and the present from then on.
    assert!(passed <= span + MAX_BATCH.as_micros() as f64);
    let calm = machine.last();
    assert!((calm.factor - 1.0).abs() < 0.01, "{calm:?}");
    assert!(calm.lateness < Duration::from_millis(10), "{calm:?}");
    let lost = calm.lost;
    machine.run(10, 10);
    assert_eq!(machine.last().lost, lost);
}

#[test]
fn a_machine_that_slept_goes_on_where_it_stood() {
    let mut machine = Machine::new();
    machine.run(2, 10);
    let reached = machine.reached;
    machine.real += Duration::from_secs(3_600);
    machine.turn(10);
    assert_eq!(machine.reached, reached + MAX_BATCH);
    assert!(machine.last().lateness > Duration::from_secs(3_599));
    machine.run(2, 10);
    let lost = machine.last().lost;
    let hour = Duration::from_secs(3_600);
    assert!(lost <= hour, "{lost:?}");
    assert!(hour.saturating_sub(lost) <= MAX_BATCH, "{lost:?}");
    // Deadlines lie where real time will meet them.
    let due = machine.reached + CONTROL;
    assert!(machine.pacer.real(due) - machine.real <= CONTROL);
}
