defmodule Aerie.CLI.Status.Lines do
  @moduledoc """
  The status as lines of the log, for a pipe or `--quiet`: one line per vehicle, one per link and one for NATS. Each is its
  message with its pairs, for `Aerie.Base.Log.Formatter.line/5`, which leaves out what is nil.
  """

  import Aerie.CLI.Status.Format

  alias Aerie.CLI.Status.View
  alias Aerie.Vehicle.Snapshot

  @type line :: {message :: String.t(), [{atom(), term()}]}
  @typedoc "When all lines were written, monotonic ms, and what was said of each since then."
  @type told :: {all_at :: integer(), MapSet.t()} | nil

  # Numbers grow old with the next line, but a change of one of these is a reason for it.
  @reasons ~w(vehicle status via mode armed gps link client nats url hub problem system component ALARM)a
  @all_ms 60_000

  @doc "The lines of one snapshot."
  @spec render(View.t()) :: [line()]
  def render(%View{} = view) do
    Enum.map(view.vehicles, &vehicle(&1, view)) ++
      Enum.map(view.links, &link/1) ++
      Enum.flat_map(view.clients, &client/1) ++ nats(view) ++ identity(view.identity)
  end

  @doc """
  The lines to write: all of them at first and once a minute, and in between those that say that something is in another state, because
  a log that is kept on a flash card wears it out.
  """
  @spec due([line()], told(), now :: integer()) :: {[line()], told()}
  def due(lines, told, now) do
    said = MapSet.new(lines, &state/1)

    case told do
      {all_at, before} when now - all_at < @all_ms ->
        {Enum.reject(lines, &(state(&1) in before)), {all_at, said}}

      _never_or_long_ago ->
        {lines, {now, said}}
    end
  end

  defp state({message, pairs}), do: {message, Keyword.take(pairs, @reasons)}

  @doc "Where the console is, and the file with the address that signs in: a log must not have that itself."
  @spec console(String.t() | nil, Aerie.Config.t() | nil) :: [line()]
  def console(http, %{console: %{enabled: true, dir: dir}}) when http != nil,
    do: [{"console", console: http, sign_in_with_the_address_in: Path.join(dir, "url")}]

  def console(_http, _config), do: []

  @doc "An open interface, and who may use it, as a log line."
  @spec interface(Aerie.CLI.Status.Access.interface()) :: line()
  def interface(interface), do: {"interface", open: interface.address, to: interface.who}

  @doc "An event as a line of the table: vehicle, type and data, without the position."
  @spec note(map()) :: String.t()
  def note(event) do
    "#{text(event.vehicle)} #{text(event.type)}  #{data(Map.delete(event.data, "position"))}"
  end

  @doc "An event as a log line; `at` is when it happened, which is in the past for a recording."
  @spec event(map()) :: line()
  def event(event),
    do: {"event", [vehicle: event.vehicle, type: event.type, at: time(event.time)] ++ Enum.sort(event.data)}

  defp time(us) do
    us |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond) |> DateTime.to_iso8601()
  end

  defp data(data) do
    data
    |> flat()
    |> Enum.map_join(" ", fn {key, value} -> "#{key}=#{value(value)}" end)
  end

  # `position: %{lat: 1}` becomes `position.lat=1`.
  defp flat(data) do
    Enum.flat_map(Enum.sort(data), fn
      {key, %{} = inner} when not is_struct(inner) ->
        for {name, value} <- flat(inner), do: {"#{key}.#{name}", value}

      {key, value} ->
        [{key, value}]
    end)
  end

  defp vehicle(vehicle, view) do
    {"vehicle",
     [
       vehicle: vehicle.id,
       status: vehicle.status,
       via: vehicle.via,
       type: vehicle.vehicle_type,
       autopilot: vehicle.autopilot,
       mode: Snapshot.data(vehicle, :mode)[:mode],
       armed: Snapshot.data(vehicle, :mode)[:armed],
       lat: rounded(Snapshot.data(vehicle, :position)[:lat], 6),
       lon: rounded(Snapshot.data(vehicle, :position)[:lon], 6),
       alt_rel: rounded(Snapshot.data(vehicle, :position)[:alt_rel], 1),
       groundspeed: rounded(Snapshot.data(vehicle, :velocity)[:groundspeed], 1),
       battery: rounded(Snapshot.data(vehicle, :battery)[:remaining], 2),
       gps: Snapshot.data(vehicle, :gps)[:fix_name],
       age: seconds(Snapshot.silent_us(vehicle, view.links, view.now))
     ]}
  end

  defp seconds(nil), do: nil
  defp seconds(us), do: rounded(us / 1_000_000, 1)

  defp rounded(value, decimals) when is_float(value), do: Float.round(value, decimals)
  defp rounded(value, _decimals), do: value

  defp link(link) do
    {"link",
     link: link.id,
     status: link.status,
     frames_in_per_s: round(link.rates.frames_in),
     writes_out_per_s: round(link.rates.writes_out),
     crc_errors: link.counters.crc_errors,
     lost: link.counters.lost,
     denied: link.counters.denied,
     dropped_out: link.counters.dropped_out,
     dropped_in: View.dropped_in(link),
     text: link.text}
  end

  # Only clients that lost frames; `/api/clients` has the rest.
  defp client(%{counters: counters} = client) do
    dropped_in = View.dropped_in(client)

    if counters.dropped_out + dropped_in > 0 do
      [
        {"client",
         client: client.id, dropped_out: counters.dropped_out, dropped_in: dropped_in, text: client.text}
      ]
    else
      []
    end
  end

  defp nats(%{nats: nil}), do: []

  defp nats(%{nats: nats} = view) do
    [
      {"nats",
       nats: if(nats.connected, do: "connected", else: "away"),
       url: nats.url,
       published: view.published,
       events_waiting: Map.get(nats.outbox, :events, 0) + view.pending,
       problem: nats.problem || nats.outbox[:problem]}
      | hub(nats[:hub])
    ]
  end

  defp hub(nil), do: []

  defp hub(hub),
    do: [
      {"hub",
       hub: if(hub.status == :up, do: "connected", else: "away"),
       events_waiting: hub.waiting,
       problem: hub.problem}
    ]

  defp identity(nil), do: []

  defp identity(%{alarm: alarm} = own) do
    [{"identity", system: own.system, component: own.component, ALARM: alarm}]
  end

  defp value(value) when is_map(value) or is_list(value) or is_tuple(value),
    do: value |> inspect(limit: 20, printable_limit: 200) |> value()

  defp value(value) do
    text = text(value)
    if text =~ ~r/[\s"=]/, do: inspect(text), else: text
  end
end
