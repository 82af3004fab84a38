defmodule Aerie.Fleet.Replay do
  @moduledoc """
  Replays a recorded flight through the cores of a live gateway (parser, the router's rules, vehicle core, detector,
  samplers), in the recording's own time and without a process: a test vector.

      {:ok, flight} = Aerie.Fleet.Replay.run("flight.tlog")
      for event <- flight.events, do: {event.time, event.type, event.data}

  The same recording always gives the same result, to the byte: the clock is never read, and timers fire by the recording's
  time. A recording of a gateway (`MavRouter.Recorder`) gives the same events as that gateway; `replay/README.md` lists the
  exceptions.

  To watch a recording use the link `replay:FILE` or `bin/run --replay FILE`; for its events as JSON lines
  `aerie replay FILE`.
  """

  alias Aerie.Fleet.Replay.{Machine, Settings, Source}
  alias Aerie.Vehicle.Event
  alias MavCodec.Tlog

  @typedoc """
  In the order in which they occur:

  - `{:event, event}`: an event of a vehicle
  - `{:sample, sample}`: a sample for the fleet: `%{vehicle, group, at, time_boot_ms, data}`, `at` in unix microseconds
  - `{:send, request}`: a message that the gateway would have sent: `%{vehicle, at, message, version}`
  - `{:status, change}`: a vehicle is online, stale or lost: `%{vehicle, at, from, to}`
  """
  @type output :: {:event, Event.t()} | {:sample, map} | {:send, map} | {:status, map}

  @typedoc """
  - `from`, `to`: times of the first frame (with a time after 2000, if there is one) and the last (unix microseconds)
  - `duration_us`: how long it is, without steps of its clock and gaps of more than a day
  - `vehicles`: their names; `stations`: what else sent heartbeats (`t:MavRouter.Forward.GroundStations.station/0`)
  - `frames`, `bytes`: read from the recording
  - `own`: frames with our own ids; `copies`: texts that came by two links; `unclaimed`: frames of systems without a vehicle;
    `refused`: heartbeats of vehicles beyond `limits.max_vehicles`
  - `jumps`: how often the time went back, or a recorder that had no clock got one
  - `unknown_ids`, `lost`, `sources`: as in `MavCodec.Parser.stats/1`
  - `damaged_parts`, `damaged_bytes`, `damage`: what is not a valid record, with the first hundred parts
  """
  @type summary :: %{
          from: integer,
          to: integer,
          duration_us: non_neg_integer,
          vehicles: [String.t()],
          stations: [MavRouter.Forward.GroundStations.station()],
          frames: pos_integer,
          bytes: pos_integer,
          own: non_neg_integer,
          copies: non_neg_integer,
          unclaimed: non_neg_integer,
          refused: non_neg_integer,
          jumps: non_neg_integer,
          unknown_ids: non_neg_integer,
          lost: non_neg_integer,
          sources: map,
          damaged_parts: non_neg_integer,
          damaged_bytes: non_neg_integer,
          damage: [Tlog.Damage.t()]
        }

  @typedoc "All outputs by kind, each in order; the vehicles' last snapshots by name; the summary."
  @type flight :: %{
          events: [Event.t()],
          samples: [map],
          sent: [map],
          statuses: [map],
          snapshots: %{String.t() => map},
          summary: summary
        }

  @typedoc """
  - `:settings` - the vehicles' names, limits, sampling and our own ids; default values if absent
  - `:network` - the vehicles' network; by default that of the settings
  - `:link` - the name of the link that they are heard by; default "replay"
  - `:high_latency` - whether that is a high-latency link
  """
  @type option ::
          {:settings, Settings.t()} | {:network, String.t()} | {:link, String.t()} | {:high_latency, boolean}

  @doc """
  Replays a recording: a tlog file (gzipped or not), several in succession, or `{:chunks, pieces}` of a tlog's bytes.

  Damaged parts are skipped and counted. The error is a text: the file cannot be read, is empty, or has no MAVLink record. A
  recording without a vehicle is not an error.
  """
  @spec run(Source.t(), [option]) :: {:ok, flight} | {:error, String.t()}
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

  @doc "Like `run/2`, but passes each output to a function, so that memory does not grow with the recording."
  @spec reduce(Source.t(), [option], acc, (output, acc -> acc)) ::
          {:ok, acc, summary} | {:error, String.t()}
        when acc: term
  def reduce(source, options, acc, fun) do
    with {:ok, acc, machine} <- play(source, options, acc, fun), do: {:ok, acc, Machine.summary(machine)}
  end

  defp play(source, options, acc, fun) do
    options = Keyword.validate!(options, [:settings, :network, :link, :high_latency])
    settings = options[:settings] || Settings.from(%{})
    machine = Machine.new(settings, options)

    step = fn item, {machine, acc} ->
      {machine, outputs} = Machine.push(machine, item)
      {machine, Enum.reduce(outputs, acc, fun)}
    end

    case Source.reduce(source, Machine.parser(settings), {machine, acc}, step) do
      {:ok, {machine, acc}} ->
        case Machine.unreadable(machine) do
          nil ->
            {machine, outputs} = Machine.finish(machine)
            {:ok, Enum.reduce(outputs, acc, fun), machine}

          text ->
            {:error, name(source) <> text}
        end

      {:error, text} ->
        {:error, text}
    end
  end

  defp name({:chunks, _chunks}), do: "recording: "
  defp name(paths) when is_list(paths), do: "#{Enum.join(paths, ", ")}: "
  defp name(path), do: "#{path}: "
end
