"""The measurement chain, shot by shot: truth, beams, hits, echoes, measurement; and bench patterns."""
