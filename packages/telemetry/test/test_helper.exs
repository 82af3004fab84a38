# A busy machine may need many times as long.
ExUnit.start(timeout: 1_200_000)
