"""Pictures of clips and rollouts: off-screen rendering, contact sheets, videos."""
