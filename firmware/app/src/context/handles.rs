//! What each activity may write. A handle reads as the robot itself.
//!
//! An activity asks for its handle once and hands it on below; a test holds the others to leaving
//! it alone.

use core::cell::Cell as Value;
use core::ops::Deref;

use crawler_hal::{Duration, Instant, PANIC_TEXT, ResetCause};
use crawler_protocol::{Level, Reason, ResponseStatus};
use embassy_sync::blocking_mutex::raw::RawMutex;
use heapless::Vec;

use super::{BootRecord, Robot, Snapshot, cut};
use crate::behaviour::{Course, Leeway};
use crate::controller::PERIOD;
use crate::goal::Goal;
use crate::navigation::{Destination, Excerpt, Guide, Navigator, Other};
use crate::neighbours::{Cell, MOST, Near};
use crate::order::{Halt, Order, Sender, SetRequest, UpdateWish};
use crate::parameters::Parameters;
use crate::perception::{Battery, LinkHealth, Reading};
use crate::policy::shadow::{Candidate, Compared};
use crate::policy::{Asked, Decision, Installed};
use crate::tracking::{Fix, Refusal};
use crate::trouble::{LinkTrouble, PANIC};
use crate::vision::View;

macro_rules! handle {
    ($(#[$about:meta])* $name:ident, $ask:ident) => {
        $(#[$about])*
        pub(crate) struct $name<'a, M: RawMutex>(&'a Robot<M>);

        impl<M: RawMutex> Clone for $name<'_, M> {
            fn clone(&self) -> Self {
                *self
            }
        }

        impl<M: RawMutex> Copy for $name<'_, M> {}

        impl<M: RawMutex> Deref for $name<'_, M> {
            type Target = Robot<M>;

            fn deref(&self) -> &Robot<M> {
                self.0
            }
        }

        impl<M: RawMutex> Robot<M> {
            $(#[$about])*
            pub(crate) const fn $ask(&self) -> $name<'_, M> {
                $name(self)
            }
        }
    };
}

handle!(
    /// What [`sense()`](crate::sense()) may write.
    SenseHandle,
    sense_handle
);
handle!(
    /// What [`power()`](crate::power()) may write.
    PowerHandle,
    power_handle
);
handle!(
    /// What [`control()`](crate::control()) may take and write.
    ControlHandle,
    control_handle
);
handle!(
    /// What [`store()`](crate::store()) may take and write.
    StoreHandle,
    store_handle
);
handle!(
    /// What [`camera()`](crate::camera()) may take and write.
    CameraHandle,
    camera_handle
);
handle!(
    /// What [`lamp()`](crate::lamp()) may take.
    LampHandle,
    lamp_handle
);
handle!(
    /// What [`link()`](crate::link()) may take and write.
    LinkHandle,
    link_handle
);

handle!(
    /// What [`update()`](crate::update()) may write.
    UpdateHandle,
    update_handle
);

handle!(
    /// What [`decide()`](crate::decide()) may take and write.
    PolicyHandle,
    policy_handle
);

impl<'a, M: RawMutex> PolicyHandle<'a, M> {
    /// Tells control what comes with the program to drive by.
    pub(crate) fn install(self, installed: Installed) {
        self.0.decisions.install(installed);
    }

    /// Waits for an observation.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn asked(self) -> impl Future<Output = (Asked, u32)> + use<'a, M> {
        self.0.decisions.asked()
    }

    /// Hands control what was decided.
    pub(crate) fn decide(self, decision: Decision) {
        self.0.decisions.decide(decision);
    }

    /// Whether an observation waits.
    pub(crate) fn is_asked(self) -> bool {
        self.0.decisions.is_asked()
    }

    /// Who is to decide beside the policy that drives, and whose name that stands for.
    pub(crate) fn candidate(self, driving: u32) -> Option<Candidate> {
        self.0.shadows.candidate(driving)
    }

    /// Counts what it has decided.
    pub(crate) fn count(self, candidate: Candidate, driving: u32, compared: Compared) {
        self.0.shadows.count(candidate, driving, compared);
    }
}

impl<M: RawMutex> UpdateHandle<'_, M> {
    /// Tells control what the update wants.
    pub(crate) fn wish(self, wish: UpdateWish) {
        self.0.update_wish.lock(|cell| cell.set(wish));
    }

    /// Has the camera look, or not, for the sake of a model on trial.
    pub(crate) fn try_out_eyes(self, tried: bool) {
        self.0.sights.try_out(tried);
    }

    /// Tells control what a release has brought to drive by, and what it has brought in vain.
    pub(crate) fn bring(self, brought: Installed, unfit: Installed) {
        self.0.decisions.bring(brought, unfit);
        self.0.shadows.begin_anew();
    }
}

impl<M: RawMutex> SenseHandle<'_, M> {
    /// Publishes what the ranger says.
    pub(crate) fn publish(self, reading: &Reading) {
        self.0.reading.lock(|cell| cell.set(*reading));
    }

    /// Publishes which way to go.
    pub(crate) fn guide_to(self, guide: Guide) {
        self.0.guide.lock(|cell| cell.set(Some(guide)));
    }

    /// Reckons what those who are near at `now` leave of the speed of a robot on `course`, and publishes it.
    pub(crate) fn keep_off(self, course: &Course, now: Instant) {
        let mut leeway = Leeway::ALL;
        self.0
            .neighbours
            .each(now, |known| leeway = leeway.beside(course, known));
        self.keep_to(leeway);
    }

    /// Publishes what others leave.
    pub(crate) fn keep_to(self, leeway: Leeway) {
        self.0.leeway.lock(|cell| cell.set(leeway));
    }

    /// Copies the part of the map that is wanted, if any is; `None` is no map.
    // Inlined, the copy would lie on the stack of the whole activity.
    #[inline(never)]
    pub(crate) fn report_map(self, navigator: Option<&Navigator>, now: Instant) {
        let reports = &self.0.map_reports;
        let origin = navigator.map(|navigator| navigator.map().origin());
        let Some(row) = reports.wanted(origin) else {
            return;
        };
        if let Some(navigator) = navigator {
            reports.show(&navigator.excerpt(row, self.0.going().is_some()));
            self.0.outbox.nudge();
        } else if let Some(Sender { source, seq }) = reports.give_up() {
            let none = Some(Reason::NoMap);
            self.0
                .respond(&source, seq, ResponseStatus::Failed, none, now);
        }
    }

    /// Who is near at `now`.
    pub(crate) fn others(self, now: Instant) -> Vec<Other, MOST> {
        let mut others = Vec::new();
        self.0.neighbours.each(now, |known| {
            // There is room for all.
            let _ = others.push(Other {
                at: known.at,
                velocity: known.velocity(),
            });
        });
        others
    }
}

impl<M: RawMutex> PowerHandle<'_, M> {
    /// Publishes what was measured.
    pub(crate) fn publish(self, battery: Battery) {
        self.0.battery.lock(|cell| cell.set(battery));
        self.0.battery_measured.signal(());
    }
}

impl<'a, M: RawMutex> ControlHandle<'a, M> {
    /// Notes why the program started, and logs how it panicked before.
    pub(crate) fn set_boot_cause(self, cause: ResetCause, panic: Option<&str>, now: Instant) {
        let text = panic.map(cut::<PANIC_TEXT>).unwrap_or_default();
        let panicked = !text.is_empty();
        if panicked {
            self.0.log(Level::Error, PANIC, format_args!("{text}"), now);
            self.0.panic.lock(|cell| cell.replace(text));
        }
        self.0.boot.lock(|cell| {
            cell.set(BootRecord {
                cause,
                panicked,
                ..cell.get()
            });
        });
    }

    /// Returns when a halt may have been requested since the last return.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn halt_asked(self) -> impl Future<Output = ()> + use<'a, M> {
        self.0.halt.asked()
    }

    /// Whether a halt waits.
    pub(crate) fn halt_waits(self) -> bool {
        self.0.halt.waits()
    }

    /// Takes the halt that waits.
    pub(crate) fn take_halt(self) -> Option<Halt> {
        self.0.halt.try_take()
    }

    /// Whether an order waits: cheaper than to take none.
    pub(crate) fn order_waits(self) -> bool {
        !self.0.orders.is_empty()
    }

    /// Takes the next order.
    pub(crate) fn take_order(self) -> Option<Order> {
        self.0.orders.try_receive().ok()
    }

    /// Takes what was decided, if it was not taken yet.
    pub(crate) fn take_decision(self) -> Option<Decision> {
        self.0.decisions.take()
    }

    /// Asks for a decision of the policy whose name that stands for.
    pub(crate) fn ask_policy(self, asked: Asked, name: u32) {
        self.0.decisions.ask(asked, name);
    }

    /// Takes the newest view of the camera, if it was not taken yet.
    pub(crate) fn take_view(self) -> Option<View> {
        self.0.sights.take()
    }

    /// Begins or ends looking; also has the camera read its parameters anew.
    pub(crate) fn want_views(self, wanted: bool) {
        self.0.sights.want(wanted);
    }

    /// Whether an outside position reference waits.
    pub(crate) fn fix_waits(self) -> bool {
        self.0.tracking.waits()
    }

    /// Takes the newest outside position reference, if it was not taken yet.
    pub(crate) fn take_fix(self) -> Option<Fix> {
        self.0.tracking.take()
    }

    /// Brings `near` up to who is near, and where they should be at `now`.
    pub(crate) fn look_around(self, near: &mut Near, now: Instant) {
        self.0.neighbours.look(near, now);
    }

    /// Publishes where the robot is to go.
    pub(crate) fn go(self, going: Option<Destination>) {
        self.0.going.lock(|cell| cell.set(going));
    }

    /// Takes the behaviour that the restart before this boot interrupted.
    pub(crate) fn take_goal_before_restart(self) -> Option<Goal> {
        let goal = &self.0.behaviour_before_restart;
        // Nearly always there is none, and one is large.
        goal.signaled().then(|| goal.try_take()).flatten()
    }

    /// Has the behaviour kept that a restart is about to interrupt.
    pub(crate) fn keep_goal(self, goal: Goal) {
        self.0.behaviour_to_keep.signal(goal);
    }

    /// Counts the periods that were missed when a step comes `elapsed` after the one before it.
    pub(crate) fn count_missed(self, elapsed: Duration) {
        // In 32 bits, in which boards divide by themselves.
        let periods = elapsed.as_micros() as u32 / PERIOD.as_micros() as u32;
        if periods > 1 {
            self.0
                .missed
                .lock(|cell| cell.set(cell.get().wrapping_add(periods - 1)));
        }
    }

    /// Publishes what telemetry and the lamp need to know.
    pub(crate) fn publish(self, snapshot: &Snapshot) {
        self.0.snapshot.lock(|cell| cell.set(*snapshot));
    }

    /// Has the lamp blink until then for whoever looks for the robot.
    pub(crate) fn identify(self, until: Instant) {
        self.0.identify_until.lock(|cell| cell.set(until));
    }

    /// Has the lamp look for another pattern.
    pub(crate) fn wake_lamp(self) {
        self.0.lamp_changed.signal(());
    }
}

impl<'a, M: RawMutex> StoreHandle<'a, M> {
    /// The robot, to read alone, for as long as it lives.
    pub(crate) const fn shared(self) -> &'a Robot<M> {
        self.0
    }

    /// Waits until the battery was measured.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn battery_measured(self) -> impl Future<Output = ()> + use<'a, M> {
        self.0.battery_measured.wait()
    }

    /// Waits for the next `set`.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn next_set(self) -> impl Future<Output = SetRequest> + use<'a, M> {
        self.0.set_requests.receive()
    }

    /// Waits for a behaviour that a restart is about to interrupt.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn goal_to_keep(self) -> impl Future<Output = Goal> + use<'a, M> {
        self.0.behaviour_to_keep.wait()
    }

    /// Puts other parameters in force; who sends them is told by [`Self::tell_parameters`].
    pub(crate) fn set_parameters(self, next: Parameters) {
        self.0.replace_parameters(next);
    }

    /// The retained message of the parameters is out of date.
    pub(crate) fn tell_parameters(self) {
        self.0.parameters_changed.signal(());
    }

    /// The flash has been read, or has been given up.
    pub(crate) fn set_loaded(self) {
        self.0.loaded.lock(|cell| cell.set(true));
    }

    /// Notes how many boots there were, this one included.
    pub(crate) fn set_boot_count(self, count: u32) {
        self.0.boot.lock(|cell| {
            cell.set(BootRecord {
                count,
                ..cell.get()
            });
        });
    }

    /// Hands control the behaviour that the restart before this boot interrupted.
    pub(crate) fn set_goal_before_restart(self, goal: Option<Goal>) {
        if let Some(goal) = goal {
            self.0.behaviour_before_restart.signal(goal);
        }
    }
}

impl<'a, M: RawMutex> CameraHandle<'a, M> {
    /// Waits for a still that was asked for.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn next_capture(self) -> impl Future<Output = Sender> + use<'a, M> {
        self.0.captures.next()
    }

    /// Ends the capture: another one may be asked for.
    pub(crate) fn close_capture(self) {
        self.0.captures.close();
    }

    /// Whether to look.
    pub(crate) fn views_wanted(self) -> bool {
        self.0.sights.is_wanted()
    }

    /// Returns when control has said since the last return whether to look.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn wishes_changed(self) -> impl Future<Output = ()> + use<'a, M> {
        self.0.sights.changed()
    }

    /// Hands a view to control, and to the link if it is news after `told`. Whether it is.
    pub(crate) fn show(self, view: &View, told: Option<&View>) -> bool {
        self.0.sights.show(view, told)
    }
}

impl<'a, M: RawMutex> LampHandle<'a, M> {
    /// Until when to blink for whoever looks for the robot.
    pub(crate) fn identify_until(self) -> Instant {
        self.0.identify_until.lock(Value::get)
    }

    /// Returns when the pattern may have changed since the last return.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn changed(self) -> impl Future<Output = ()> + use<'a, M> {
        self.0.lamp_changed.wait()
    }
}

impl<'a, M: RawMutex> LinkHandle<'a, M> {
    /// Tells control how the session with the broker is.
    pub(crate) fn set_health(self, health: LinkHealth) {
        self.0.set_link_health(health);
    }

    /// Notes what keeps the robot from its broker.
    pub(crate) fn set_trouble(self, trouble: Option<LinkTrouble>) {
        if self.0.link_trouble.lock(|cell| cell.replace(trouble)) != trouble {
            self.0.lamp_changed.signal(());
        }
    }

    /// Waits until the retained message of the parameters is out of date.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn parameters_changed(self) -> impl Future<Output = ()> + use<'a, M> {
        self.0.parameters_changed.wait()
    }

    /// Takes what was seen last, unless that was told already or has waited for too long.
    pub(crate) fn take_news(self, now: Instant) -> Option<View> {
        self.0.sights.take_news(now)
    }

    /// The part of the map that waits to be sent, and the number of the command that asked for it.
    pub(crate) fn map_excerpt(self) -> Option<(u64, Excerpt)> {
        self.0.map_reports.excerpt()
    }

    /// Notes that it was sent, and answers the command after the last one.
    pub(crate) fn map_sent(self, now: Instant) {
        if let Some(Sender { source, seq }) = self.0.map_reports.sent() {
            let completed = ResponseStatus::Completed;
            self.0.respond(&source, seq, completed, None, now);
        }
    }

    /// Takes in an outside position reference.
    ///
    /// # Errors
    /// Why it was refused; that is counted.
    pub(crate) fn take_fix(self, payload: &[u8], now: Instant) -> Result<(), Refusal> {
        let (own, unix) = (&self.0.config.id, self.0.unix_ms(now));
        self.0.tracking.observe(payload, own, unix, now)
    }

    /// How many were refused since that was told last, when it is time to tell it again.
    pub(crate) fn refusals_to_tell(self, now: Instant) -> Option<u32> {
        self.0.tracking.refusals_to_tell(now)
    }

    /// Takes in a message on the topic of `cell`. Whether it was of use.
    pub(crate) fn take_cell(self, cell: Cell, payload: &[u8], now: Instant) -> bool {
        let (own, here) = (&self.0.config.id, self.0.snapshot().pose);
        let unix = self.0.unix_ms(now);
        self.0
            .neighbours
            .observe(cell, payload, (own, &here), unix, now)
    }
}
