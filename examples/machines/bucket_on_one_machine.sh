#!/bin/bash
# A plan's store in a bucket on this machine: of moto, a server that speaks S3's protocol, or of Azurite, Microsoft's emulator of
# Azure's. The worker has an empty cache folder, gets encoder, runtime, documents and embeddings from the bucket, and the merged
# log has to be that of `memtransfer run`.
#
#     cargo build --release --workspace --bins --features orchestrator/object-store
#     pip install 'moto[server]' azure-storage-blob
#     npm install azurite
#     PATH=target/release:$PATH examples/machines/bucket_on_one_machine.sh s3
#     PATH=target/release:node_modules/.bin:$PATH examples/machines/bucket_on_one_machine.sh azure
#
# The server listens on 127.0.0.1 and ends with the script.
set -euo pipefail

folder=$(mktemp -d)
cd "$folder"
case "${1:-}" in
s3)
    python3 -m moto.server --host 127.0.0.1 --port 0 2>server.log &
    ;;
azure)
    # The client's settings for the emulator name this port.
    azurite-blob --blobPort 10000 --location "$folder/azurite" --disableTelemetry --skipApiVersionCheck >server.log 2>&1 &
    ;;
*)
    echo "usage: $0 s3|azure" >&2
    exit 2
    ;;
esac
server=$!
trap 'kill $server; wait $server 2>/dev/null || true; rm -rf "$folder"' EXIT
for _ in {1..600}; do grep -qs 'http://127.0.0.1:' server.log && break || sleep 0.1; done

case "$1" in
s3)
    address=$(grep -o 'http://127.0.0.1:[0-9]*' server.log | head -1)
    export AWS_ENDPOINT=$address AWS_ALLOW_HTTP=true AWS_REGION=us-east-1
    export AWS_ACCESS_KEY_ID=test AWS_SECRET_ACCESS_KEY=test
    python3 -c 'import sys, urllib.request as r; r.urlopen(r.Request(sys.argv[1] + "/units", method="PUT"))' "$address"
    bucket=s3://units
    ;;
azure)
    export AZURE_STORAGE_USE_EMULATOR=true AZURE_ALLOW_HTTP=true
    python3 - <<'PYTHON'
from azure.storage.blob import BlobServiceClient

# The account and the key of every emulator, which are public.
key = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="
service = BlobServiceClient("http://127.0.0.1:10000/devstoreaccount1", {"account_name": "devstoreaccount1", "account_key": key})
service.create_container("units")
PYTHON
    bucket=az://units
    ;;
esac

settings=(--suite quick --policy grounded --memory "summary,episodic" --limit 3)
memtransfer run "${settings[@]}" --lanes 1 --out whole --quiet >/dev/null
for _ in 1 2; do
    # The second time, everything is there.
    memtransfer plan "${settings[@]}" --out plan.json --store $bucket/shared --quiet
done
if MEMTRANSFER_CACHE=$folder/cache memtransfer work --plan plan.json --unit 0 --out units --store $bucket/elsewhere --quiet; then
    echo "a file that is not there was found" >&2
    exit 1
fi
MEMTRANSFER_CACHE=$folder/cache memtransfer work --plan plan.json --unit 0 --out units --quiet
memtransfer merge --plan plan.json units --out merged
find cache -type f -not -path '*/views/*' -printf '%P %s\n'
cmp merged/episodes.jsonl whole/episodes.jsonl
echo "the merged log is that of one run: $(wc -l <merged/episodes.jsonl) episodes"
