"""Pyxel's own calibration of one named parameter, run by a Python in which it is installed: reads a job, writes its champion.

``python pyxel_calibration.py JOB.json ANSWER.json``: imports nothing of isetval.
"""

import json
import sys
from pathlib import Path

TEMPLATE = """
calibration:
  result_type: image
  result_fit_range: [0, {rows}, 0, {cols}]
  target_fit_range: [0, {rows}, 0, {cols}]
  target_data_path: {targets}
  result_input_arguments:
    - key: pipeline.photon_collection.illumination.arguments.level
      values: {levels}
  fitness_function:
    func: pyxel.calibration.fitness.sum_of_squared_residuals
    arguments:
  algorithm:
    type: sade
    generations: {generations}
    population_size: {population}
  pygmo_seed: {seed}
  pipeline_seed: {seed}
  num_islands: 1
  num_evolutions: 1
  parameters:
    - key: {key}
      values: _
      logarithmic: false
      boundaries: {bounds}
ccd_detector:
  geometry:
    row: {rows}
    col: {cols}
    total_thickness: 3.0
    pixel_vert_size: {pixel_um}
    pixel_horz_size: {pixel_um}
  environment:
    temperature: 300.0
  characteristics:
    quantum_efficiency: 0.5
    charge_to_volt_conversion: {volt_per_e}
    pre_amplification: 1.0
    full_well_capacity: {full_well_e}
    adc_bit_resolution: 10
    adc_voltage_range: [0.0, 1.023]
pipeline:
  photon_collection:
    - {{name: illumination, func: pyxel.models.photon_collection.illumination, enabled: true, arguments: {{level: 1.0}}}}
    - {{name: shot_noise, func: pyxel.models.photon_collection.shot_noise, enabled: true}}
  charge_generation:
    - {{name: photoelectrons, func: pyxel.models.charge_generation.simple_conversion, enabled: true}}
    - {{name: dark_current, func: pyxel.models.charge_generation.dark_current, enabled: true,
       arguments: {{figure_of_merit: {figure_of_merit}}}}}
  charge_collection:
    - {{name: collection, func: pyxel.models.charge_collection.simple_collection, enabled: true}}
    - {{name: fixed_pattern_noise, func: pyxel.models.charge_collection.fixed_pattern_noise, enabled: true,
       arguments: {{fixed_pattern_noise_factor: {prnu}}}}}
    - {{name: full_well, func: pyxel.models.charge_collection.simple_full_well, enabled: true}}
  charge_measurement:
    - {{name: measurement, func: pyxel.models.charge_measurement.simple_measurement, enabled: true}}
    - {{name: dc_offset, func: pyxel.models.charge_measurement.dc_offset, enabled: true, arguments: {{offset: {offset_v}}}}}
    - {{name: output_node_noise, func: pyxel.models.charge_measurement.output_node_noise, enabled: true,
       arguments: {{std_deviation: {noise_v}}}}}
  readout_electronics:
    - {{name: amplifier, func: pyxel.models.readout_electronics.simple_amplifier, enabled: true}}
    - {{name: adc, func: pyxel.models.readout_electronics.simple_adc, enabled: true}}
"""


def main(job_file, answer_file):
    """Run the calibration of a job and write fitness and value of its champion."""
    import pyxel

    job = json.loads(Path(job_file).read_text(encoding="utf-8"))
    where = Path(job_file).with_suffix(".yaml")
    where.write_text(TEMPLATE.format(**job), encoding="utf-8")
    found = pyxel.run_mode(pyxel.load(where), with_inherited_coords=True)
    champion = found["champion"]
    answer = {
        "version": pyxel.__version__,
        "fitness": float(champion["champion_fitness"].values.ravel()[-1]),
        "value": float(champion["champion_parameters"].values.ravel()[-1]),
    }
    Path(answer_file).write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
