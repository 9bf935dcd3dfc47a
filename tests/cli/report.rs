//! `report`: the page of a run once more, and pictures as files.

use super::kit::prelude::*;

#[test]
fn a_run_gives_its_page_and_every_picture_of_it() {
    let desk = Desk::new();
    let out = desk.out();
    call("run --headless --port sim: --out {}", &[&out]).expect(0);
    let run = only_folder(&out);
    let kept = fs::read_to_string(run.join("report.html")).unwrap();
    let figures = desk.path("figures");
    let done = json_of("report {} --svg {} --json", &[&run, &figures]);
    assert_eq!(done["page"], json!(run.join("report.html")));
    let pictures = done["pictures"].as_array().unwrap();
    assert_eq!(pictures.len(), kept.matches("<svg class=\"plot").count());
    for picture in pictures {
        let svg = fs::read_to_string(picture.as_str().unwrap()).unwrap();
        assert!(svg.starts_with("<?xml") && svg.trim_end().ends_with("</svg>"));
    }

    // They are not written over, and the help names the next step.
    let again = refusal("report {} --svg {}", &[&run, &figures]);
    has(&again, &["figure-1.svg", "exists already", "--svg"]);

    // The page of the record anew is that of the run but for what only the live run knew: its plan.
    let anew = desk.path("anew.html");
    call("report {} --output {}", &[&run, &anew]).expect(0);
    let anew = fs::read_to_string(anew).unwrap();
    let estimates = |html: &str| {
        let (_, rest) = html.split_once("<h2>Parameters").unwrap();
        rest.split_once("</section>").unwrap().0.to_owned()
    };
    assert_eq!(estimates(&anew), estimates(&kept));
    let picture = |html: &str| {
        let (_, rest) = html.split_once("<svg class=\"plot").unwrap();
        rest.split_once("</script>").unwrap().0.to_owned()
    };
    assert_eq!(picture(&anew), picture(&kept));

    // Whoever has lost the page gets it again; a page that is there is not written over.
    fs::remove_file(run.join("report.html")).unwrap();
    call("report {}", &[&run]).expect(0);
    assert!(run.join("report.html").exists());
    let again = refusal("report {} --output {}", &[&run, &run.join("report.html")]);
    has(&again, &["exists already"]);
    let page = refusal("report {}", &[&run.join("report.html")]);
    has(&page, &["--svg DIR"]);
    let markdown = call("report {} --markdown", &[&run]).expect(0);
    has(&markdown.stdout, &["| resistance_ohm "]);
    // Rows of a table stay whole, however wide: each has the bars of the one before it.
    let rows: Vec<&str> = markdown.stdout.lines().collect();
    let bars = |row: &str| row.replace("\\|", "").matches('|').count();
    let tables = rows.windows(2).filter(|two| two.iter().all(|row| row.starts_with('|')));
    let wrong: Vec<_> = tables.filter(|two| bars(two[0]) != bars(two[1])).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
    assert!(rows.iter().any(|row| row.chars().count() > 100));
}

#[test]
fn time_on_the_page_counts_from_the_start_of_the_run() {
    let desk = Desk::new();
    let rows = (0..200).map(|k| format!("{},{},{}\n", 5000.0 + 0.01 * f64::from(k), k % 7, k));
    let text = format!("t,u,w\n{}", rows.collect::<String>());
    let log = desk.put("log.csv", &text);
    let page = desk.path("page.html");
    let map = "time_s=t,voltage_v=u,speed_rad_s=w";
    let done = drivebench([
        "report",
        log.to_str().unwrap(),
        "--output",
        page.to_str().unwrap(),
        "--map",
        map,
    ]);
    done.expect(0);
    let html = fs::read_to_string(page).unwrap();
    let (_, axis) = html.split_once("data-x=\"").unwrap();
    assert!(axis.starts_with("0 1.9"), "{}", &axis[..40]);
}
