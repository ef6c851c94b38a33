//! Joins the bus of a run and prints the metrics that its processes publish.
//!
//! ```sh
//! lodestone train --listen tcp/127.0.0.1:7447                     # in one terminal
//! cargo run --example join_a_bus -- tcp/127.0.0.1:7447            # in another
//! cargo run --example join_a_bus                                  # without a run: talks to itself
//! ```

use bus::{Bus, BusConfig, BusMode};
use proto::Valid;

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let config = match std::env::args().nth(1) {
        // A client connects to one router. Every other setting has a default.
        Some(router) => BusConfig { mode: BusMode::Client, connect: vec![router], ..BusConfig::default() },
        // A router without a listen endpoint: other processes cannot join, but this process can use the bus.
        None => BusConfig::default(),
    };
    let config = Valid::new(config)?;
    let bus = Bus::open(&config).await?;

    // A subscriber first receives the latest value of each key, then every new one. `**` matches all keys; try
    // `actor/*`.
    let mut metrics = bus.metrics_subscriber("**").await?;

    if config.mode == BusMode::Router {
        // Metrics are JSON, so scripts need no schema. Any serializable type works.
        let publisher = bus.metrics_publisher("actor/example").await?;
        publisher.put(&serde_json::json!({ "episodes_total": 1 })).await?;
        publisher.put(&serde_json::json!({ "episodes_total": 2 })).await?;
        print_next(&mut metrics, 2).await;
    } else {
        print_next(&mut metrics, 20).await;
    }

    // Sends everything that is queued, then closes the session; the other processes see at once that this one left.
    bus.close().await;
    Ok(())
}

async fn print_next(metrics: &mut bus::MetricsSubscriber, n_samples: usize) {
    for _ in 0..n_samples {
        let Some(sample) = metrics.recv().await else { break };
        println!("{}: {}", sample.suffix, sample.value);
    }
}
