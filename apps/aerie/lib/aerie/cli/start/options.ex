defmodule Aerie.CLI.Start.Options do
  @moduledoc """
  The options of `aerie start` (`bin/run`): their rows for `Aerie.CLI.Subcommands`, and the check of what was given. Pure.
  """

  defstruct links: [],
            replay: nil,
            speed: 1.0,
            sim: nil,
            sim_msp: 0,
            config: nil,
            http: nil,
            nats: nil,
            quiet: false

  alias Aerie.CLI.Start.SimMsp

  @typedoc """
  * `links` - connection strings, in the order given
  * `replay` - path of a tlog file to play, or nil
  * `speed` - of a replay or of simulated vehicles, as a multiple of real time; `:max` for a replay
  * `sim` - number of simulated vehicles, or nil if the command line does not say; `sim_msp` - of those that speak MSP
  * `config` - path of a YAML configuration, or nil
  * `http` - port of the HTTP server, or nil for the configured one
  * `nats` - "embedded" or a URL, or nil for the configured server
  * `quiet` - log lines instead of the table
  """
  @type t :: %__MODULE__{
          links: [String.t()],
          replay: String.t() | nil,
          speed: float() | :max,
          sim: non_neg_integer() | nil,
          sim_msp: non_neg_integer(),
          config: String.t() | nil,
          http: :inet.port_number() | nil,
          nats: String.t() | nil,
          quiet: boolean()
        }

  @max_sim 200

  @all [
    {:link, :keep, "STRING", "connect to vehicles"},
    {:replay, :string, "FILE", "play a recorded flight (a .tlog file) instead of connecting to vehicles"},
    {:speed, :string, "N|max",
     "with --replay: playback speed, up to 1000 times real time (default 1); with --sim: the vehicles' time, 0.1 to 100 times real time"},
    {:sim, :integer, "N", "number of simulated vehicles (0 to #{@max_sim}); also together with links"},
    {:sim_msp, :integer, "N",
     "number of simulated Betaflight and iNav vehicles (0 to #{SimMsp.most()}), which speak MSP"},
    {:config, :string, "FILE", "configuration file; config/gateway.example.yaml documents every key"},
    {:http, :integer, "PORT",
     "port of the HTTP server: /api, /metrics, /healthz, /readyz (0 takes a free one)"},
    {:nats, :string, "WHERE", "embedded (the default) or a URL such as nats://hub:4222"},
    {:quiet, :boolean, nil,
     "log lines instead of the status table (the default if the output is not a terminal)"},
    {:version, :boolean, nil, "print the version"}
  ]

  @doc "The rows of the options (`t:Aerie.CLI.Subcommand.option/0`)."
  @spec all() :: [Aerie.CLI.Subcommand.option()]
  def all, do: @all

  @doc "What their values may be (`t:Aerie.CLI.Subcommand.t/0`)."
  @spec terms() :: {String.t(), [{String.t(), String.t()}]}
  def terms, do: {"STRING is one of:", MavRouter.Link.Transport.help()}

  @doc "Checks the options that were given: the struct, or what is wrong and what is expected."
  @spec check(%{atom() => term()}) :: {:ok, t()} | {:error, String.t()}
  def check(given) do
    options = %__MODULE__{
      links: given[:link] || [],
      replay: given[:replay],
      sim: given[:sim],
      sim_msp: given[:sim_msp] || 0,
      config: given[:config],
      http: given[:http],
      nats: given[:nats],
      quiet: given[:quiet] || false
    }

    with {:ok, speed} <- speed(given[:speed]),
         :ok <- range("--sim", options.sim, 0, @max_sim),
         :ok <- range("--sim-msp", options.sim_msp, 0, SimMsp.most()),
         :ok <- range("--http", options.http, 0, 65_535),
         :ok <- replay_alone(options, given),
         :ok <- nats(options.nats),
         do: {:ok, %{options | speed: speed}}
  end

  defp speed(nil), do: {:ok, 1.0}
  defp speed("max"), do: {:ok, :max}

  defp speed(text) do
    case Float.parse(text) do
      {speed, ""} when speed > 0 and speed <= 1000 -> {:ok, speed}
      _other -> {:error, "--speed: expected a number above 0 and up to 1000, or max, got: #{text}"}
    end
  end

  defp range(_name, nil, _low, _high), do: :ok
  defp range(_name, value, low, high) when value >= low and value <= high, do: :ok
  defp range(name, value, low, high), do: {:error, "#{name}: expected #{low} to #{high}, got: #{value}"}

  defp replay_alone(%{replay: nil}, given) do
    case given[:speed] && {given[:sim], speed(given[:speed])} do
      nil -> :ok
      {nil, _speed} -> {:error, "--speed needs --replay FILE or --sim N"}
      {_sim, {:ok, speed}} when is_float(speed) and speed >= 0.1 and speed <= 100 -> :ok
      _other -> {:error, "--speed: expected 0.1 to 100 with --sim, got: #{given[:speed]}"}
    end
  end

  defp replay_alone(%{links: [_ | _]}, _given),
    do: {:error, "--replay and --link exclude each other: a recording must not mix with live vehicles"}

  defp replay_alone(_options, _given), do: :ok

  defp nats(nil), do: :ok
  defp nats("embedded"), do: :ok

  defp nats(url) do
    case URI.parse(url) do
      %URI{scheme: scheme, host: host} when scheme in ["nats", "tls"] and is_binary(host) and host != "" ->
        :ok

      _other ->
        {:error, "--nats: expected embedded or a URL such as nats://127.0.0.1:4222, got: #{url}"}
    end
  end
end
