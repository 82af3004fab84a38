import Config

config :logger, :default_formatter,
  format: "$time $metadata[$level] $message\n",
  metadata: [:gateway, :link, :vehicle]

if config_env() == :test do
  config :logger, level: :warning

  # What a test waits for comes at once on an idle machine. This is for busy ones, and guards against hanging: nothing is
  # measured by it, and it costs nothing when what is awaited comes (Aerie.Patience).
  config :ex_unit, assert_receive_timeout: 180_000, timeout: 1_200_000
  # How long a client waits for a nats-server.
  config :gnat, answer_ms: 60_000
end

if config_env() == :prod do
  config :logger, level: :info
end
