# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`.
ExUnit.start(exclude: [:long, :soak])
