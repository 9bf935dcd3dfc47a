//! Time of one cycle of the loop, or of one row of a record, on each hot path.

mod common;
#[path = "common/kernels.rs"]
mod kernels;
#[path = "common/rows.rs"]
mod rows;

use common::records;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

fn hot_paths(criterion: &mut Criterion) {
    for (id, make) in kernels::ALL {
        let (group, name) = id.split_once('/').expect("group/name");
        let mut kernel = make();
        let mut group = criterion.benchmark_group(group);
        group.throughput(Throughput::Elements(kernel.elements as u64));
        group.bench_function(name, |bencher| bencher.iter(|| (kernel.work)()));
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = common::settings();
    targets = hot_paths
}
criterion_main!(benches);
