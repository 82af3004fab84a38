import Config

config :logger, :default_formatter,
  format: "$time $metadata[$level] $message\n",
  metadata: [:gateway, :link, :vehicle]

# The application starts no gateway by itself: bin/run, a release and each test start the instance they want.
config :vehicle, autostart: false
config :fleet_web, autostart: false

if config_env() == :test do
  config :logger, level: :warning
end

if config_env() == :prod do
  config :logger, level: :info
end
