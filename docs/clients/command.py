"""Signs a command, sends it over NATS, and prints its progress and its result. docs/commands.md describes the signature.

    pip install nats-py cryptography
    python command.py URL SEED_FILE fleet.dev.sim-001.cmd.takeoff '{"params": {"altitude": 20}}'

Transfers (docs/transfers.md) are asked for in the same way. Without an id in the body it makes one.

Exit status: 0 completed or accepted, 1 any other result, or no answer. Then the same id may be asked for again.
"""
import asyncio, base64, binascii, datetime, json, sys, uuid
import nats
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey


def parsed(body):
    try:
        value = json.loads(body)
    except ValueError as error:
        sys.exit(f"the body is not JSON ({error}): {body}")
    return value if isinstance(value, dict) else sys.exit(f"the body is not a JSON object: {body}")


async def command(url, seed_file, subject, body="{}"):
    try:
        seed = base64.b32decode(open(seed_file).read().strip() + "======")
        key = Ed25519PrivateKey.from_private_bytes(seed[2:34])
    except ValueError as error:
        sys.exit(f"{seed_file} has no seed, which begins with SU ({error})")
    public = b"\xa0" + key.public_key().public_bytes_raw()
    public = base64.b32encode(public + binascii.crc_hqx(public, 0).to_bytes(2, "little")).decode()

    now, body = datetime.datetime.now(datetime.timezone.utc), {"id": uuid.uuid4().hex} | parsed(body)
    id, body = body["id"], json.dumps(body).encode()
    text = b"\n".join([b"aerie-command-1", subject.encode(), now.isoformat().encode(), body])
    signature = base64.urlsafe_b64encode(key.sign(text)).decode().rstrip("=")

    async def show(message):
        print("progress", message.data.decode(), flush=True)

    client = await nats.connect(url, allow_reconnect=False)
    await client.subscribe(f"{subject}.progress.{id}", cb=show)
    headers = {"Aerie-Signature": f"{public} {now.isoformat()} {signature}"}
    reply = await client.request(subject, body, timeout=90, headers=headers)
    await client.drain()  # shows the progress that came before
    print("result", reply.data.decode())
    return json.loads(reply.data)["result"] not in ("completed", "accepted")


if len(sys.argv) not in (4, 5):
    sys.exit("usage: python command.py URL SEED_FILE SUBJECT [BODY]")
try:
    sys.exit(asyncio.run(command(*sys.argv[1:])))
except nats.errors.Error as error:
    sys.exit(f"no answer: {error!r}")
except OSError as error:
    sys.exit(f"{error}")
