use blueprints::Catalogue;
use environment::*;
use proto::*;
use rand::{RngExt, SeedableRng};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let n: u64 = args[1].parse().unwrap();
    let start = args[2].as_str();
    let filter = args.get(3).cloned().unwrap_or_default();
    let trace = args.get(4).is_some();
    let only: Option<u64> = args.get(4).and_then(|s| s.parse().ok());
    let mut config = EnvironmentConfig::default();
    if let Ok(g) = std::env::var("GRIPPERS") { config.n_grippers = g.parse().unwrap(); }
    let catalogue = match std::env::var("CAT") { Ok(p) => Box::leak(Box::new(Catalogue::load(std::path::Path::new(&p)).unwrap())), Err(_) => Catalogue::builtin() };
    let mut world = World::new(&config).unwrap();
    let (mut all_steps, mut t_expert, mut t_env) = (0u64, 0.0, 0.0);
    let mut by_size: std::collections::BTreeMap<usize, (u64, u64, u64)> = Default::default();
    for b in catalogue.iter() {
        if !filter.is_empty() && !b.id().as_str().starts_with(&filter) { continue; }
        let (mut ok, mut steps_ok, mut ends) = (0, 0u64, String::new());
        for e in 0..n {
            if only.is_some_and(|o| o != e) { continue; }
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1000 * e + 7);
            let assignment = sample_assignment(&mut rng);
            let others: Vec<_> = catalogue.of_split(blueprints::Split::Train).into_iter().filter(|o| o.id() != b.id()).collect();
            let pre = Start::Prebuilt(others[rng.random_range(0..others.len())].id().clone());
            let s = match start { "scattered" => Start::Scattered, "prebuilt" => pre, _ => if e % 5 == 4 { pre } else { Start::Scattered } };
            let mut task = Task { blueprint: b.id().clone(), assignment, start: s, seed: rng.random() };
            while world.reset(&task, catalogue).is_err() { task.seed += 1; }
            let t0 = std::time::Instant::now();
            let Ok(mut expert) = Expert::new(&config, world.blueprint()) else { println!("{} NO PLAN", b.id()); break };
            t_expert += t0.elapsed().as_secs_f64();
            let mut steps = 0;
            loop {
                let t0 = std::time::Instant::now();
                let action = expert.act(world.scene());
                t_expert += t0.elapsed().as_secs_f64();
                if trace {
                    let sc = world.scene();
                    let d = |g: usize| action.choices[g].map(|c| { let p = sc.blocks[c.get()].position; format!("{:2} at {:.2} {:.2} {:.2} mv {:?}", c.get(), p[0], p[1], p[2], action.moves[c.get()].map(|x| (x * 100.0) as i32)) }).unwrap_or_default();
                    println!("{steps:3} j{} [{}] [{}] heavy {}", sc.joints.len(), d(0), d(1), sc.n_heavy_contacts);
                    println!("     {}", expert.describe(sc)); for c in action.choices.iter().flatten() { println!("     near {}: {}", c.get(), expert.near(sc, *c)); }
                }
                let t0 = std::time::Instant::now();
                let r = world.step(&action);
                t_env += t0.elapsed().as_secs_f64();
                steps += 1;
                match r.status { Status::Running => continue, Status::Success => { ok += 1; steps_ok += steps; ends.push('.'); } Status::TimeLimit => ends.push('T'), Status::Diverged => ends.push('D') }
                break;
            }
            all_steps += steps;
        }
        let entry = by_size.entry(b.n_blocks()).or_default();
        *entry = (entry.0 + ok, entry.1 + n, entry.2 + steps_ok);
        println!("{:16} {:3}/{n} steps {:5.1} {ends} {}", b.id(), ok, steps_ok as f64 / ok.max(1) as f64, b.title());
    }
    for (size, (ok, n, steps)) in by_size { println!("size {size:2}: {:5.1} % of {n}, {:.1} steps", 100.0 * ok as f64 / n as f64, steps as f64 / ok.max(1) as f64); }
    println!("expert {:.1} us/step, world {:.1} us/step, {all_steps} steps", 1e6 * t_expert / all_steps as f64, 1e6 * t_env / all_steps as f64);
}
