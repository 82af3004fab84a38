defmodule AerieCLI.Status.Lines do
  @moduledoc """
  The status as log lines, for a pipe or `--quiet`: one line per vehicle, one per link and one for NATS, as `key=value`
  pairs that `grep` and log collectors can read.
  """

  import AerieCLI.Status.Format

  alias Aerie.Fleet.Age
  alias AerieCLI.Status.View

  @doc "The lines of one snapshot."
  @spec render(View.t()) :: [String.t()]
  def render(%View{} = view) do
    Enum.map(view.vehicles, &vehicle(&1, view)) ++
      Enum.map(view.links, &link/1) ++
      Enum.flat_map(view.clients, &client/1) ++ nats(view) ++ identity(view.identity)
  end

  @doc "One way into the gateway, and who may use it, as a log line."
  @spec face(AerieCLI.Status.Faces.face()) :: String.t()
  def face(face), do: pairs(open: face.address, to: face.who)

  @doc "An event as a line of the table: vehicle, type and data, without the position."
  @spec note(map()) :: String.t()
  def note(event) do
    "#{text(event.vehicle)} #{text(event.type)}  #{data(Map.delete(event.data, "position"))}"
  end

  @doc "An event as a log line; `time` is when it happened, which is in the past for a recording."
  @spec event(map()) :: String.t()
  def event(event) do
    String.trim_trailing(
      "event vehicle=#{text(event.vehicle)} type=#{text(event.type)} time=#{time(event.time)} #{data(event.data)}"
    )
  end

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
    pairs = [
      vehicle: vehicle.id,
      status: vehicle.status,
      type: vehicle.vehicle_type,
      autopilot: vehicle.autopilot,
      mode: View.field(vehicle, :mode, :mode),
      armed: View.armed(vehicle),
      lat: number(View.field(vehicle, :position, :lat), 6),
      lon: number(View.field(vehicle, :position, :lon), 6),
      alt_rel: number(View.field(vehicle, :position, :alt_rel), 1),
      groundspeed: number(View.field(vehicle, :velocity, :groundspeed), 1),
      battery: percent(View.field(vehicle, :battery, :remaining)),
      gps: View.field(vehicle, :gps, :fix_name),
      age: seconds(Age.silent_us(vehicle, view.links, view.now))
    ]

    pairs(pairs)
  end

  defp seconds(nil), do: nil
  defp seconds(us), do: number(us / 1_000_000, 1)

  defp link(link) do
    pairs(
      link: link.id,
      status: link.status,
      frames_in_per_s: number(link.rates.frames_in, 0),
      writes_out_per_s: number(link.rates.writes_out, 0),
      crc_errors: link.counters.crc_errors,
      lost: link.counters.lost,
      denied: link.counters.denied,
      dropped_out: link.counters.dropped_out,
      dropped_in: link.counters.kernel_dropped + link.counters.shed,
      text: link.text
    )
  end

  # Only clients that lost frames; `/api/clients` has the rest.
  defp client(%{counters: %{dropped_out: 0}}), do: []

  defp client(client),
    do: [pairs(client: client.id, dropped_out: client.counters.dropped_out, text: client.text)]

  defp nats(%{nats: nil}), do: []

  defp nats(%{nats: nats} = view) do
    pairs = [
      nats: if(nats.connected, do: "connected", else: "away"),
      url: nats.url,
      published: view.published,
      events_waiting: Map.get(nats.outbox, :events, 0) + view.pending,
      problem: nats.problem || nats.outbox[:problem]
    ]

    [pairs(pairs)]
  end

  defp identity(nil), do: []

  defp identity(%{alarm: alarm} = own) do
    shown = [system: own.system, component: own.component]
    [pairs(if(alarm, do: shown ++ [ALARM: alarm], else: shown))]
  end

  defp pairs(pairs), do: Enum.map_join(pairs, " ", fn {key, value} -> "#{key}=#{value(value)}" end)

  defp value(value) when is_map(value) or is_list(value) or is_tuple(value),
    do: value |> inspect(limit: 20, printable_limit: 200) |> value()

  defp value(value) do
    text = text(value)
    if text =~ ~r/[\s"=]/, do: inspect(text), else: text
  end
end
