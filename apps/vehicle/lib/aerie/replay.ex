defmodule Aerie.Replay do
  @moduledoc """
  A recorded flight as a test vector: the recording goes through the cores that a live gateway runs (parser, the router's
  rules, vehicle core, detector, samplers), in the recording's own time and without a process.

      {:ok, flight} = Aerie.Replay.run("flight.tlog")
      for event <- flight.events, do: {event.time, event.type, event.data}

  The same recording gives the same result, to the byte: nothing asks what time it is, timers fire when the recording's
  time says so. What was recorded by a gateway (`Aerie.Recorder`) gives the events that the gateway gave, for what is in
  the recording; the README of this module's folder says what is not.

  For watching a recording there is the link `replay:FILE`, `bin/run --replay FILE`; for its events as JSON lines
  `bin/run --replay FILE --events`.
  """

  alias Aerie.Replay.{Machine, Source}
  alias Aerie.Vehicle.Event
  alias MavCodec.Tlog

  @typedoc """
  In the order in which they come about:

  - `{:event, event}`: something happened to a vehicle
  - `{:sample, sample}`: what goes to the fleet: `%{vehicle, group, at, time_boot_ms, data}`, `at` in unix microseconds
  - `{:send, request}`: what the gateway would have sent: `%{vehicle, at, message, version}`
  - `{:status, change}`: a vehicle is heard, silent, lost: `%{vehicle, at, from, to}`
  """
  @type output :: {:event, Event.t()} | {:sample, map} | {:send, map} | {:status, map}

  @typedoc """
  - `from`, `to`: times of the first and the last frame (unix microseconds)
  - `vehicles`: their names; `stations`: who else sent heartbeats (`t:Aerie.Router.Stations.station/0`)
  - `frames`, `bytes`: taken from the recording
  - `own`: frames of our own ids; `copies`: texts that two links brought; `unclaimed`: of systems without a vehicle;
    `refused`: heartbeats of vehicles beyond `limits.max_vehicles`
  - `jumps_back`: how often the time began anew
  - `unknown_ids`, `lost`, `sources`: as of `MavCodec.Parser.stats/1`
  - `damaged_parts`, `damaged_bytes`, `damage`: what is no record, with the first hundred parts
  """
  @type summary :: %{
          from: integer,
          to: integer,
          vehicles: [String.t()],
          stations: [Aerie.Router.Stations.station()],
          frames: pos_integer,
          bytes: pos_integer,
          own: non_neg_integer,
          copies: non_neg_integer,
          unclaimed: non_neg_integer,
          refused: non_neg_integer,
          jumps_back: non_neg_integer,
          unknown_ids: non_neg_integer,
          lost: non_neg_integer,
          sources: map,
          damaged_parts: non_neg_integer,
          damaged_bytes: non_neg_integer,
          damage: [Tlog.Damage.t()]
        }

  @typedoc "All outputs, by kind and each in its order; the vehicles as they are at the end, by name; the summary."
  @type flight :: %{
          events: [Event.t()],
          samples: [map],
          sent: [map],
          statuses: [map],
          snapshots: %{String.t() => map},
          summary: summary
        }

  @typedoc """
  - `:config` - an `Aerie.Config`, or any map with some of its keys: vehicles' names, limits, sampling, our own ids
  - `:network` - the network that the vehicles are on; by default the configuration's
  - `:link` - the link that they are heard by, for what names it; "replay"
  - `:high_latency` - that link is one of high latency
  """
  @type option ::
          {:config, map} | {:network, String.t()} | {:link, String.t()} | {:high_latency, boolean}

  @doc """
  Plays a recording: a tlog file (gzipped or not), several that follow each other, or `{:chunks, pieces}` of a tlog's
  bytes. Instead of options a configuration will do.

  Damaged parts cost themselves and are counted. The error, in words: the file cannot be read, is empty, or holds no
  record of MAVLink. A recording without a vehicle is none.
  """
  @spec run(Source.t(), [option] | map) :: {:ok, flight} | {:error, String.t()}
  def run(source, options \\ []) do
    empty = %{event: [], sample: [], send: [], status: []}
    keep = fn {kind, output}, kept -> Map.update!(kept, kind, &[output | &1]) end

    with {:ok, kept, machine} <- play(source, options, empty, keep) do
      {:ok,
       %{
         events: Enum.reverse(kept.event),
         samples: Enum.reverse(kept.sample),
         sent: Enum.reverse(kept.send),
         statuses: Enum.reverse(kept.status),
         snapshots: Machine.snapshots(machine),
         summary: Machine.summary(machine)
       }}
    end
  end

  @doc "The same with each output given to a function as it comes about: memory does not grow with the recording."
  @spec reduce(Source.t(), [option] | map, acc, (output, acc -> acc)) ::
          {:ok, acc, summary} | {:error, String.t()}
        when acc: term
  def reduce(source, options, acc, fun) do
    with {:ok, acc, machine} <- play(source, options, acc, fun), do: {:ok, acc, Machine.summary(machine)}
  end

  defp play(source, options, acc, fun) do
    options = if is_map(options), do: [config: options], else: options
    options = Keyword.validate!(options, [:network, :link, :high_latency, config: %{}])
    machine = Machine.new(options[:config], options)

    step = fn item, {machine, acc} ->
      {machine, outputs} = Machine.push(machine, item)
      {machine, Enum.reduce(outputs, acc, fun)}
    end

    case Source.reduce(source, Machine.parser(options[:config]), {machine, acc}, step) do
      {:ok, {%{counts: %{frames: 0}}, _acc}} ->
        {:error, "#{name(source)}holds no record of MAVLink (is it a tlog?)"}

      {:ok, {machine, acc}} ->
        {:ok, acc, machine}

      {:error, words} ->
        {:error, words}
    end
  end

  defp name({:chunks, _chunks}), do: "the recording "
  defp name(paths) when is_list(paths), do: "#{Enum.join(paths, ", ")}: "
  defp name(path), do: "#{path}: "
end
