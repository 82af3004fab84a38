# What a test waits for comes at once on an idle machine; a busy one needs patience, which costs nothing when it comes.
ExUnit.start(assert_receive_timeout: 180_000, timeout: 1_200_000, exclude: Aerie.Browser.excluded())
