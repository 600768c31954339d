"""Refine and texture a folder of objects on this machine's cores, the worst first."""

from pathlib import Path

from photoreg.batch.batch import BatchConfig, BatchFinished, run_batch
from photoreg.batch.collection import read_collection
from photoreg.batch.settings import ObjectSettings
from photoreg.registration.config import RegistrationConfig

if __name__ == "__main__":  # Dask's workers import this file, too.
    asked = ObjectSettings(config=RegistrationConfig.preset("fast"))
    collection = read_collection(Path("objects"), asked)
    for event in run_batch(collection, Path("results"), BatchConfig(workers=2)):
        if isinstance(event, BatchFinished):
            for row in sorted(event.rows, key=lambda row: row.rank):
                print(f"{row.name}: {row.verdict or row.status}. {row.sentence}")
            print(f"All of them: {event.page}")
