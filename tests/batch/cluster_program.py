"""Starts a batch's own cluster and waits to be told to end, to be looked at meanwhile."""

from photoreg.batch.cluster import connected

if __name__ == "__main__":
    with connected(None, 1, 1) as client:
        client.wait_for_workers(1)
        print("ready", flush=True)
        input()
