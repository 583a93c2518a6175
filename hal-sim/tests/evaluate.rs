//! Evaluated runs of the real program.

use std::sync::atomic::{AtomicBool, Ordering};

use crawler_sim::evaluate::{
    Criterion, Evaluation, Job, Line, Search, run_all, run_trial, run_unless, shrink,
};
use crawler_sim::scenario::{Metric, Scenario, Trained};

/// One robot, two metres to go, straight ahead.
const STRAIGHT: &str = "
name = \"straight\"
duration_s = 40.0
[arena]
width = 5.0
height = 3.0
[spawn]
poses = [{ x = -1.0, y = 0.0 }]
[[goals]]
x = 1.0
y = 0.0
";

fn parse(text: &str) -> Scenario {
    Scenario::parse(text).unwrap()
}

#[test]
fn a_straight_way_is_driven_and_measured() {
    let trial = run_trial(&parse(STRAIGHT), 1);
    assert_eq!(trial.failures, []);
    let measured = |metric| trial.measured.get(metric).unwrap();
    assert_eq!(measured(Metric::Success), 1.0);
    assert_eq!(measured(Metric::Reached), 1.0);
    // 1.75 m at 0.3 m/s, after a start from rest.
    let time = measured(Metric::TimeToGoalS);
    assert!((5.8..7.0).contains(&time), "{time} s");
    assert!(measured(Metric::PathOptimality) > 0.98);
    let driven = measured(Metric::DistanceM);
    assert!((1.75..2.0).contains(&driven), "{driven} m");
    assert_eq!(measured(Metric::Collisions), 0.0);
    assert_eq!(measured(Metric::CommandSuccess), 1.0);
    assert_eq!(measured(Metric::Uptime), 1.0);
    // The electronics draw 0.15 A of 8.2 V all the time. The rest are two motors against 0.4 N of
    // friction each over 1.9 m, at a fifth of efficiency.
    let energy = measured(Metric::EnergyJ);
    let motors = energy - 0.15 * 8.2 * trial.ran_s;
    assert!((6.0..11.0).contains(&motors), "{motors} J of {energy} J");
    assert_eq!(trial.measured.get(Metric::RecoveryS), None);
    // It ends when everything is done, and not after all of 40 s.
    assert!(trial.ran_s < 25.0, "{} s", trial.ran_s);
}

#[test]
fn a_run_can_be_given_up_in_the_middle() {
    // Four weeks, with nowhere to go: it ends when it is told to.
    let (idle, _) = STRAIGHT.split_once("[[goals]]").unwrap();
    let scenario = parse(&idle.replace("40.0", "2419200.0"));
    let (seed, stop) = (1, AtomicBool::new(false));
    let job = Job {
        scenario: &scenario,
        seed,
    };
    std::thread::scope(|scope| {
        let (tell, begun) = std::sync::mpsc::channel();
        let (job, asked) = (&job, &stop);
        let run = scope.spawn(move || {
            tell.send(()).unwrap();
            run_unless(job, asked)
        });
        begun.recv().unwrap();
        // However far it comes meanwhile, it has weeks to go.
        std::thread::sleep(std::time::Duration::from_millis(50));
        stop.store(true, Ordering::Relaxed);
        assert_eq!(run.join().unwrap(), None);
    });
    assert_eq!(run_unless(&job, &stop), None);
    // One that is let alone is what it is without a flag.
    let scenario = parse(STRAIGHT);
    let job = Job {
        scenario: &scenario,
        seed: 1,
    };
    let whole = run_unless(&job, &AtomicBool::new(false)).unwrap();
    assert_eq!(whole, run_trial(&scenario, 1));
    let lines = Line::all(&[whole.measured]);
    assert_eq!(lines, Evaluation::new(&scenario, vec![whole], &[]).lines);
}

#[test]
fn what_goes_wrong_is_named() {
    let walled = format!(
        "{STRAIGHT}\n[success]\nreach = \"all\"\nwithin_s = 8.0\ndistance_m = 50.0\nalive = \"all\"\n"
    );
    let trial = run_trial(&parse(&walled), 1);
    let criteria: Vec<_> = trial
        .failures
        .iter()
        .map(|failure| failure.criterion)
        .collect();
    assert_eq!(criteria, [Criterion::Reach, Criterion::Distance]);
    let crowded = parse("name = \"crowded\"\nrobots = 500\n[arena]\nwidth = 3.0\nheight = 3.0");
    let trial = run_trial(&crowded, 1);
    assert_eq!(trial.failures[0].criterion, Criterion::SetUp);
    assert_eq!(trial.measured.get(Metric::Success), Some(0.0));
}

#[test]
fn a_run_goes_on_to_its_end_where_that_is_asked() {
    let whole = STRAIGHT.replace("duration_s", "ends_early = false\nduration_s");
    // A robot that breaks down long after it has arrived is not alive at the end.
    let broken = "[[faults]]\nat_s = 12.0\nfor_s = 60.0\nfault = \"ranger-dead\"\n\
                  [[commands]]\nat_s = 12.0\ncommand = \"behave\"\n\
                  parameters = { behaviour = \"wander\" }\n";
    let trial = run_trial(&parse(&format!("{whole}{broken}")), 1);
    assert_eq!(trial.ran_s, 40.0);
    assert_eq!(trial.measured.get(Metric::Reached), Some(1.0));
    let criteria: Vec<_> = trial.failures.iter().map(|f| f.criterion).collect();
    assert_eq!(criteria, [Criterion::Alive, Criterion::Stranded]);
}

#[test]
fn who_has_finished_its_rounds_is_not_stranded() {
    let patrol = "
name = \"rounds\"
duration_s = 90.0
[arena]
width = 4.0
height = 4.0
[spawn]
poses = [{ x = 0.0, y = 0.0 }]
[command]
command = \"behave\"
parameters = { behaviour = \"patrol\", waypoints = [[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]], laps = 1 }
[success]
alive = \"all\"
stranded = 0
command_success = 1.0
distance_m = 1.0
";
    let trial = run_trial(&parse(patrol), 1);
    assert_eq!(trial.failures, []);
    assert_eq!(trial.measured.get(Metric::Stranded), Some(0.0));
    assert_eq!(trial.measured.get(Metric::Dropouts), Some(0.0));
    // One that breaks down on its rounds is.
    let broken = "[[faults]]\nat_s = 12.0\nfor_s = 500.0\nfault = \"ranger-dead\"\n";
    let trial = run_trial(&parse(&format!("{patrol}{broken}")), 1);
    let stranded =
        |failure: &crawler_sim::evaluate::Failure| failure.criterion == Criterion::Stranded;
    assert!(trial.failures.iter().any(stranded), "{:?}", trial.failures);
}

/// Four robots that stand in a square of 0.8 m, and one in a corner far away.
const STANDING: &str = "
name = \"standing\"
robots = 5
duration_s = 14.0
[arena]
width = 8.2
height = 8.2
[spawn]
poses = [{ x = 0.0, y = 0.0 }, { x = 0.8, y = 0.0 }, { x = 0.0, y = 0.8 }, { x = 0.8, y = 0.8 }, { x = -3.0, y = -3.0 }]
";

#[test]
fn a_swarm_is_measured_and_judged() {
    let wanted = "[success]\norder = 0.9\nclusters = 2\nlargest_cluster = 0.8\n\
                  pair_distance_m = 0.79\ncoverage = 0.2\nevenness = 0.1\nlattice_degree = 1.5\n\
                  spacing_error_m = 0.02\nsettle_s = 12.0\ncontacts_per_minute = 0.0\n";
    let text = format!("{STANDING}{wanted}");
    let trial = run_trial(&parse(&text), 1);
    assert_eq!(trial.failures, []);
    let near = |metric, expected: f64| {
        let value = trial.measured.get(metric).unwrap();
        assert!((value - expected).abs() < 1e-3, "{metric:?} {value}");
    };
    near(Metric::Order, 1.0);
    near(Metric::Clusters, 2.0);
    near(Metric::LargestCluster, 0.8);
    near(Metric::PairDistanceM, 0.8);
    near(Metric::LatticeDegree, 1.6);
    near(Metric::ContactsPerMinute, 0.0);
    // From when the robots have booted and know the time.
    let settled = trial.measured.get(Metric::SettleS).unwrap();
    assert!((2.0..=12.0).contains(&settled), "{settled}");
    // A metre more or less, and everything is wrong but that nobody touches anybody.
    let other = text
        .replace("x = 0.8, y = 0.0", "x = 2.0, y = 1.9, theta = 3.14")
        .replace("x = 0.8, y = 0.8", "x = 0.0, y = 0.6, theta = 3.14")
        .replace("x = 0.0, y = 0.8", "x = 0.0, y = -0.95");
    let trial = run_trial(&parse(&other), 1);
    let failures = trial.failures.iter();
    let criteria: Vec<_> = failures.map(|failure| failure.criterion.name()).collect();
    let asked = parse(&text).success;
    let of_swarm = asked.of_swarm().into_iter().chain(asked.of_others());
    let asked: Vec<_> = of_swarm.map(|wanted| wanted.metric.name()).collect();
    for name in [
        "order",
        "clusters",
        "largest_cluster",
        "pair_distance_m",
        "lattice_degree",
    ] {
        assert!(criteria.contains(&name), "{name}: {criteria:?}");
    }
    assert!(criteria.contains(&"spacing_error_m") && criteria.contains(&"settle_s"));
    assert!(!criteria.contains(&"contacts_per_minute"), "{criteria:?}");
    assert!(
        criteria.iter().all(|name| asked.contains(name)),
        "{criteria:?}"
    );
    // One robot is no swarm.
    let alone = parse(&text.replace("robots = 5", "robots = 1"));
    let trial = run_trial(&alone, 1);
    assert_eq!(trial.failures.len(), 9, "{:?}", trial.failures);
    assert_eq!(trial.measured.get(Metric::ContactsPerMinute), Some(0.0));
}

/// Everybody wanders; then every ranger is dead for a while, later every link is lost, and at last everybody
/// restarts.
const INTERRUPTED: &str = "
name = \"interrupted\"
robots = 6
duration_s = 90.0
[arena]
width = 4.0
height = 4.0
[command]
command = \"behave\"
parameters = { behaviour = \"wander\" }
[[faults]]
at_s = 10.0
for_s = 3.0
fault = \"ranger-dead\"
[[faults]]
at_s = 25.0
for_s = 10.0
fault = \"link-loss\"
how = \"radio\"
[[commands]]
at_s = 50.0
command = \"reboot\"
";

#[test]
fn nobody_is_stranded_by_what_passes() {
    let trial = run_trial(&parse(INTERRUPTED), 1);
    assert_eq!(trial.failures, []);
    assert_eq!(trial.measured.get(Metric::Stranded), Some(0.0));
    // Six robots for 90 s are 0.15 hours, and each fell out three times.
    let dropouts = trial.measured.get(Metric::Dropouts).unwrap();
    assert!((dropouts - 12_000.0).abs() < 1.0, "{dropouts}");
    // Who may not go on is stranded, and the run no success.
    let never =
        "[[commands]]\nat_s = 5.0\ncommand = \"set\"\nparameters = { resume_within_ms = 0 }\n";
    let trial = run_trial(&parse(&format!("{INTERRUPTED}{never}")), 1);
    assert_eq!(trial.measured.get(Metric::Stranded), Some(6.0));
    let failures = trial.failures.iter();
    let criteria: Vec<_> = failures.map(|failure| failure.criterion).collect();
    assert_eq!(criteria, [Criterion::Stranded]);
}

#[test]
fn a_robot_recovers_from_a_fault_and_is_sent_on() {
    let fault = "[[faults]]\nat_s = 8.0\nfor_s = 4.0\nfault = \"ranger-dead\"\n";
    let text = format!("{STRAIGHT}\n{fault}\n[success]\nreach = \"all\"\nrecovery_s = 10.0\n");
    let trial = run_trial(&parse(&text), 1);
    assert_eq!(trial.failures, []);
    let recovery = trial.measured.get(Metric::RecoveryS).unwrap();
    assert!((0.0..10.0).contains(&recovery), "{recovery} s");
    // The first goto failed, the second one completed.
    assert_eq!(trial.measured.get(Metric::CommandSuccess), Some(0.5));
    let never = text
        .replace("for_s = 4.0", "for_s = 20.0")
        .replace("40.0", "25.0");
    let trial = run_trial(&parse(&never), 1);
    let criteria: Vec<_> = trial
        .failures
        .iter()
        .map(|failure| failure.criterion)
        .collect();
    assert_eq!(criteria, [Criterion::Reach]);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let scenario = parse(&STRAIGHT.replace("40.0", "10.0"));
    let jobs: Vec<_> = (1..=6)
        .map(|seed| Job {
            scenario: &scenario,
            seed,
        })
        .collect();
    let go = AtomicBool::new(false);
    let alone = run_all(&jobs, 1, &go, &|_| {});
    assert_eq!(alone, run_all(&jobs, 3, &go, &|_| {}));
    let trials: Vec<_> = alone.into_iter().flatten().collect();
    assert_eq!(trials.len(), 6);
    assert_ne!(trials[0].history, trials[1].history);
    let evaluation = Evaluation::new(&scenario, trials, &["reached >= 0.5".parse().unwrap()]);
    assert_eq!(evaluation.csv().lines().count(), 7);
    assert_eq!(evaluation.json()["trials"][5]["seed"], 6);
    assert!(evaluation.table().contains("threshold reached >= 0.5"));
    // Once stopped nothing is begun.
    let stop = AtomicBool::new(false);
    let some = run_all(&jobs, 1, &stop, &|done| {
        stop.store(done.runs == 2, Ordering::Relaxed);
    });
    assert_eq!(some.iter().flatten().count(), 2);
}

#[test]
fn a_threshold_that_is_asked_twice_counts_once() {
    let mut scenario = parse(STRAIGHT);
    scenario.thresholds = vec!["success >= 0.9".parse().unwrap()];
    let more = ["success>=0.9", "success >= 0.95"].map(|text| text.parse().unwrap());
    let evaluation = Evaluation::new(&scenario, Vec::new(), &more);
    let asked = evaluation.verdicts.iter().map(|verdict| verdict.threshold);
    assert_eq!(asked.collect::<Vec<_>>(), [scenario.thresholds[0], more[1]]);
}

#[test]
fn what_breaks_is_found_and_shrunk_to_what_matters() {
    let text = STRAIGHT
        .replace("duration_s = 40.0", "duration_s = 60.0\nrobots = 2")
        .replace("x = 1.0\ny = 0.0", "places = [[1.0, 0.0], [-1.5, 1.0]]");
    let text = format!(
        "{text}\n[[commands]]\nat_s = 5.0\nevery_s = 0.7\nrobots = [1]\ncommand = \"stop\"\n\
         [[commands]]\nat_s = 9.0\ncommand = \"identify\"\n\
         [[faults]]\nat_s = 3.0\nfor_s = 1.0\nrobots = [0]\nfault = \"ranger-dead\"\n\
         [[arena.objects]]\nshape = \"cone\"\nx = -2.2\ny = 1.2\nsize = 0.1\ncolour = \"red\"\n"
    );
    let search = Search {
        scenario: parse(&text),
        seed: 1,
        budget: 16,
        hunted: vec![Criterion::Reach],
    };
    let go = AtomicBool::new(false);
    let find = search.run(1, &go, &|_| {}).expect("it cannot arrive");
    let shrunk = shrink(&find, 60, &go, &|_| {});
    assert_eq!(shrunk.failure.criterion, Criterion::Reach);
    let small = &shrunk.scenario;
    assert_eq!((small.robots, small.commands.len()), (1, 1), "{small:?}");
    assert_eq!((small.faults.len(), small.arena.objects.len()), (0, 0));
    assert_eq!(small.goals.len(), 1);
    // What is written is what fails.
    let read = parse(&small.to_toml().unwrap());
    assert_eq!(run_trial(&read, shrunk.seed).failures, [shrunk.failure]);
}

#[test]
fn a_search_that_finds_nothing_says_so() {
    let search = Search {
        scenario: parse("name = \"idle\"\nduration_s = 8.0\n"),
        seed: 1,
        budget: 2,
        hunted: vec![Criterion::Still],
    };
    assert!(search.run(2, &AtomicBool::new(false), &|_| {}).is_none());
}

/// The first seconds of everything that is shipped, easy and hard where there is a choice.
#[test]
fn every_shipped_scenario_begins() {
    for name in Scenario::names() {
        let shipped = Scenario::built_in(name).unwrap();
        let shipped = match &shipped.difficulty {
            Some(_) => shipped.with_difficulty("0").unwrap(),
            None => shipped,
        };
        let short = shipped.with_value("duration_s", "8.0").unwrap();
        let trial = run_trial(&short, 1);
        assert_eq!(trial.ran_s, 8.0, "{name}: {:?}", trial.failures);
        if let Some(difficulty) = &short.difficulty {
            for level in difficulty.levels.keys().map(String::as_str).chain(["1"]) {
                let hard = short.clone().with_difficulty(level).unwrap();
                assert!(hard.preview(1, 1_000).is_ok(), "{name} {level}");
            }
        }
    }
    // Swarms of the three sizes that their files promise.
    for name in ["gather", "disperse", "flock", "formation"] {
        let robots = ["few", "some", "many"].map(|level| {
            let scenario = Scenario::built_in(name).unwrap();
            scenario.with_difficulty(level).unwrap().robots
        });
        assert_eq!(robots, [10, 50, 200], "{name}");
    }
}

/// What searches have found stays fixed.
#[test]
fn a_robot_gets_round_a_wide_box() {
    let scenario = parse(include_str!("../scenarios/found/goto-wide-box.toml"));
    // Seed 2 and the one it was found with did not arrive before.
    let seeds = (1..=10).chain([4_095_758_194]);
    for seed in seeds {
        let trial = run_trial(&scenario, seed);
        assert_eq!(trial.failures, [], "seed {seed}");
    }
}

/// What robots are shipped to drive by does what it was trained for, in the whole program, on seeds that it never saw; and
/// its decisions are the same on any thread.
#[test]
fn robots_get_apart_by_the_policy_that_comes_with_their_program() {
    let scenario = Scenario::built_in("spread").unwrap();
    let shipped = Trained::shipped("spread").expect("it comes with the program");
    assert_eq!(Trained::shipped("other"), None);
    let driven = scenario.clone().driven_by(shipped);
    let jobs: Vec<_> = (2_001..=2_012)
        .map(|seed| Job {
            scenario: &driven,
            seed,
        })
        .collect();
    let go = AtomicBool::new(false);
    let trials = run_all(&jobs, 2, &go, &|_| {});
    let trials: Vec<_> = trials.into_iter().flatten().collect();
    let apart = trials.iter().filter(|trial| trial.failures.is_empty());
    assert!(apart.count() >= 8, "{trials:?}");
    assert_eq!(trials[0].history, run_trial(&driven, 2_001).history);
}
