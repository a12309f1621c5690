#!/usr/bin/env bash
# Makes the files of this folder again in a temporary folder and prints its name: the reference finger as it is shipped,
# with the thermometer that the built-in scenes leave out, and a run of scans of each kind of scene.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../../../.." && pwd)
scenes=$root/host-tools/sim/scenes
reference() { taxel simulate --finger reference "$@"; }
taxel() { cargo run --quiet --release --locked --manifest-path "$root/Cargo.toml" --bin taxel -- "$@"; }
cd "$(mktemp -d)"

for scene in presses shear tour two-contacts warm-up; do
  sed '/"temperature",/d; s/^effects = \[/effects = ["temperature",/' "$scenes/$scene.toml" > $scene.toml
done
reference --scene presses.toml --seed 1 --out presses.csv
reference --scene shear.toml --seed 2 --out fit.csv
reference --scene warm-up.toml --seed 3 --out warm-up.csv
taxel calibrate fit --data presses.csv --data fit.csv --data warm-up.csv --serial VIRTUAL-4X4 --out finger.cal.toml

# The runs are at the product's rate of scans, and each begins untouched: no finger meets a force within a scan.
sed -i 's/^rate_hz = .*/rate_hz = 4000/' tour.toml shear.toml two-contacts.toml
sed -i 's/^duration_s = .*/duration_s = 2/; s/^presses = .*/presses = 4/' shear.toml
sed -i 's/^at_s = 0.8/at_s = 0.55/' two-contacts.toml      # the second comes while the first still grows
reference --scene tour.toml --out tour.csv
reference --scene shear.toml --seed 1 --out sheared.csv
reference --scene two-contacts.toml --out two.csv
# From one microsecond to before another, without the truth but for `contact`.
stretch() {
  awk -F, -v from="$2" -v to="$3" '
    /^#/ { print; next }
    !n { for (i = 1; i <= NF; i++) { if ($i == "fx_n") n = i; if ($i == "contact") c = i } s = "t_us" }
    s != "" || $1 >= from && $1 < to { s = $1; for (i = 2; i < n; i++) s = s "," $i; print s "," $c; s = "" }' "$1"
}
stretch tour.csv 0 32000 > no-contact.csv
stretch tour.csv 3520000 3648000 > normal-contact.csv
stretch sheared.csv 1220000 1380000 > shear.csv            # to 2 N and 1 N of shear, and back, in 150 ms
stretch two.csv 510000 710000 > two-contacts.csv

rm fit.csv tour.csv sheared.csv two.csv presses.csv warm-up.csv
pwd
