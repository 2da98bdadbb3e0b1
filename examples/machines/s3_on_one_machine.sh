#!/bin/bash
# A plan's store in a bucket: moto, a server that speaks S3's protocol, on this machine. The worker has an empty cache folder,
# gets encoder, runtime, documents and embeddings from the bucket, and the merged log has to be that of `memtransfer run`.
#
#     cargo build --release --workspace --bins --features orchestrator/object-store
#     pip install 'moto[server]'
#     PATH=target/release:$PATH examples/machines/s3_on_one_machine.sh
#
# The server listens on 127.0.0.1 and ends with the script.
set -euo pipefail

folder=$(mktemp -d)
python3 -m moto.server --host 127.0.0.1 --port 0 2>"$folder/moto.log" &
moto=$!
trap 'kill $moto; wait $moto 2>/dev/null || true; rm -rf "$folder"' EXIT
cd "$folder"
for _ in {1..600}; do grep -q 'Running on http' moto.log && break || sleep 0.1; done
address=$(grep -o 'http://127.0.0.1:[0-9]*' moto.log | head -1)

export AWS_ENDPOINT=$address AWS_ALLOW_HTTP=true AWS_REGION=us-east-1
export AWS_ACCESS_KEY_ID=test AWS_SECRET_ACCESS_KEY=test
python3 -c 'import sys, urllib.request as r; r.urlopen(r.Request(sys.argv[1] + "/units", method="PUT"))' "$address"

settings=(--suite quick --policy grounded --memory "summary,episodic" --limit 3)
memtransfer run "${settings[@]}" --lanes 1 --out whole --quiet >/dev/null
for _ in 1 2; do
    # The second time, everything is there.
    memtransfer plan "${settings[@]}" --out plan.json --store s3://units/shared --quiet
done
if MEMTRANSFER_CACHE=$folder/cache memtransfer work --plan plan.json --unit 0 --out units --store s3://units/elsewhere --quiet; then
    echo "a file that is not there was found" >&2
    exit 1
fi
MEMTRANSFER_CACHE=$folder/cache memtransfer work --plan plan.json --unit 0 --out units --quiet
memtransfer merge --plan plan.json units --out merged
find cache -type f -not -path '*/views/*' -printf '%P %s\n'
cmp merged/episodes.jsonl whole/episodes.jsonl
echo "the merged log is that of one run: $(wc -l <merged/episodes.jsonl) episodes"
