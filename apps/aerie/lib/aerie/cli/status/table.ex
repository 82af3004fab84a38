defmodule Aerie.CLI.Status.Table do
  @moduledoc """
  The status of a gateway as lines for a terminal. Pure: from a view and a size to at most `height` lines, none wider
  than the terminal. Colour only emphasises; every state is also a word.
  """

  import Aerie.CLI.Status.Format

  alias Aerie.CLI.Output.Columns
  alias Aerie.CLI.Status.View
  alias Aerie.Vehicle.Snapshot

  @reset "\e[0m"
  @styles %{bold: "\e[1m", dim: "\e[2m", red: "\e[31m", green: "\e[32m", yellow: "\e[33m"}

  # name, width, side
  @vehicle_columns [
    {"VEHICLE", 14, :left},
    {"STATUS", 7, :left},
    {"TYPE", 18, :left},
    {"MODE", 13, :left},
    {"ARMED", 8, :left},
    {"LATITUDE", 11, :right},
    {"LONGITUDE", 12, :right},
    {"HEIGHT", 8, :right},
    {"SPEED", 9, :right},
    {"BATTERY", 12, :right},
    {"GPS", 10, :right},
    {"HEARD", 8, :right}
  ]

  @link_columns [
    {"LINK", 14, :left},
    {"ADDRESS", 28, :left},
    {"STATE", 12, :left},
    {"IN/s", 8, :right},
    {"OUT/s", 8, :right},
    {"kB/s", 8, :right},
    {"CRC ERR", 8, :right},
    {"LOST", 8, :right}
  ]

  @doc "The vehicles as plain text, as wide as they are: for `aerie status` and `Aerie.Shell`."
  @spec vehicles(View.t()) :: iodata()
  def vehicles(%View{vehicles: []}), do: "no vehicle was heard\n"

  def vehicles(%View{} = view) do
    {columns, rows} = via(view.vehicles, Enum.map(view.vehicles, &vehicle(&1, view)))
    plain(columns, rows)
  end

  @doc "The links likewise, with what is wrong with each that is not up."
  @spec links(View.t()) :: iodata()
  def links(%View{links: []}), do: "there is no link\n"

  def links(%View{links: links}) do
    rows = for link <- links, {cells, style} = link(link), do: {cells ++ [text(link.text)], style}
    plain(@link_columns ++ [{"TEXT", 1, :left}], rows)
  end

  defp plain(columns, rows),
    do:
      Columns.render(for({name, _width, _side} <- columns, do: name), for({cells, _style} <- rows, do: cells))

  @doc "The lines of the table, the header first."
  @spec render(View.t(), pos_integer(), pos_integer()) :: [String.t()]
  def render(%View{} = view, width, height) do
    {columns, rows} = via(view.vehicles, Enum.map(view.vehicles, &vehicle(&1, view)))

    lines =
      [header(view) | console(view) ++ nats_lines(view)] ++
        alarm(view.identity) ++
        Enum.map(view.warnings, &{"WARNING: #{text(&1)}", :yellow}) ++
        [""] ++
        section(columns, rows, width, empty_vehicles()) ++
        [""] ++
        section(@link_columns, Enum.map(view.links, &link/1), width, [{"no link is configured", :dim}]) ++
        denied(view.links) ++
        dropped(view.clients) ++
        interfaces(view.interfaces) ++
        notes(view)

    lines |> Enum.take(max(height - 1, 3)) |> Enum.map(&line(&1, width))
  end

  defp header(view) do
    up = duration(view.now - view.started)

    {"Aerie #{ids(view.identity)}  up #{up}  vehicles #{length(view.vehicles)}  http #{text(view.http)}  (Ctrl-C ends it)",
     :bold}
  end

  # The address signs in, so it has a line of its own to be clicked.
  defp console(%View{console: nil}), do: []
  defp console(%View{console: url}), do: [{"console  #{text(url)}", :green}]

  defp ids(%{system: system, component: component}) when system != nil, do: "#{system}/#{component}"
  defp ids(_unknown), do: "-/-"

  defp alarm(%{alarm: alarm}) when alarm != nil, do: [{"ALARM: #{text(alarm)}", :red}]
  defp alarm(_none), do: []

  defp nats_lines(%View{nats: nil}), do: [{"NATS not started", :dim}]

  defp nats_lines(%View{nats: nats} = view) do
    waiting = Map.get(nats.outbox, :events, 0) + view.pending
    state = if nats.connected, do: "connected", else: "NOT CONNECTED, events wait on disk"
    url = text(view.nats_login || nats.url)

    [
      {"NATS #{state} #{url}  published #{view.published}  events waiting #{waiting}",
       if(nats.problem, do: :yellow, else: :green)}
      | for(
          problem <- [nats.connected && nats.problem, nats.outbox[:problem]],
          problem,
          do: {"NATS PROBLEM: #{text(problem)}", :red}
        )
    ] ++ hub(nats[:hub])
  end

  # The hub of a leaf node. Its absence is normal; its storing nothing is not.
  defp hub(nil), do: []

  defp hub(hub) do
    state = if hub.status == :up, do: "connected", else: "NOT CONNECTED, events wait here"
    style = if hub.problem, do: :yellow, else: :green

    [
      {"hub  #{state}  events waiting #{hub.waiting}", style}
      | if(hub.problem,
          do: [{"HUB PROBLEM: #{text(hub.problem)}", if(hub[:stalled], do: :red, else: :yellow)}],
          else: []
        )
    ]
  end

  # Only where some other gateway hears a vehicle is there something to say of it, and then it comes before the values.
  defp via(vehicles, rows) do
    if Enum.any?(vehicles, & &1.via) do
      [id | columns] = @vehicle_columns

      {[id, {"VIA", 16, :left} | columns],
       for(
         {vehicle, {[id | cells], style}} <- Enum.zip(vehicles, rows),
         do: {[id, via(vehicle) | cells], style}
       )}
    else
      {@vehicle_columns, rows}
    end
  end

  defp via(%{via: via}) when via != nil, do: text(via)
  defp via(_heard_here), do: ""

  defp empty_vehicles do
    [
      {"no vehicle heard yet: send a vehicle's telemetry to this machine, for example to UDP port 14550",
       :dim}
    ]
  end

  defp section(columns, rows, width, empty) do
    columns = columns_within(columns, width)
    title = Enum.map_join(columns, " ", fn {name, size, side} -> fit(name, size, side) end)
    body = if rows == [], do: empty, else: Enum.map(rows, &row(&1, columns))
    [{title, :dim} | body]
  end

  # A narrow terminal drops whole columns from the right instead of cutting lines.
  defp columns_within(columns, width) do
    {kept, _used} =
      Enum.reduce_while(columns, {[], 0}, fn {_name, size, _side} = column, {kept, used} ->
        if used + size <= width, do: {:cont, {[column | kept], used + size + 1}}, else: {:halt, {kept, used}}
      end)

    Enum.reverse(kept)
  end

  defp row({cells, style}, columns) do
    text =
      columns
      |> Enum.zip(cells)
      |> Enum.map_join(" ", fn {{_name, size, side}, cell} -> fit(cell, size, side) end)

    {text, style}
  end

  defp vehicle(vehicle, view) do
    cells = [
      text(vehicle.id),
      text(vehicle.status),
      "#{text(vehicle.vehicle_type)} #{text(vehicle.autopilot)}",
      text(Snapshot.data(vehicle, :mode)[:mode]),
      armed(Snapshot.data(vehicle, :mode)[:armed]),
      number(Snapshot.data(vehicle, :position)[:lat], 6),
      number(Snapshot.data(vehicle, :position)[:lon], 6),
      number(Snapshot.data(vehicle, :position)[:alt_rel], 1, " m"),
      number(Snapshot.data(vehicle, :velocity)[:groundspeed], 1, " m/s"),
      battery(vehicle),
      text(Snapshot.data(vehicle, :gps)[:fix_name]),
      silence(vehicle, view)
    ]

    {cells, vehicle_style(vehicle)}
  end

  defp armed(true), do: "ARMED"
  defp armed(false), do: "disarmed"
  defp armed(nil), do: "-"

  defp battery(vehicle) do
    percent(Snapshot.data(vehicle, :battery)[:remaining]) <>
      " " <> number(Snapshot.data(vehicle, :battery)[:voltage], 1, " V")
  end

  defp silence(%{status: :lost}, _view), do: "LOST"
  defp silence(vehicle, view), do: age(Snapshot.silent_us(vehicle, view.links, view.now))

  defp vehicle_style(%{status: :lost}), do: :red
  defp vehicle_style(%{status: :stale}), do: :yellow
  defp vehicle_style(vehicle), do: if(Snapshot.data(vehicle, :mode)[:armed], do: :green, else: nil)

  defp link(link) do
    cells = [
      text(link.id),
      text(link.url),
      text(link.status),
      number(link.rates.frames_in, 0),
      number(link.rates.writes_out, 0),
      number(link.rates.bytes_in / 1000, 1),
      text(link.counters.crc_errors),
      text(link.counters.lost)
    ]

    {cells, if(link.status == :up, do: nil, else: :yellow)}
  end

  defp denied(links) do
    for %{counters: %{denied: n}} = link when n > 0 <- links do
      {"link #{text(link.id)}: #{n} commands REFUSED: their senders may not command vehicles by this link (see gcs)",
       :yellow}
    end
  end

  defp dropped(clients) do
    out =
      for %{counters: %{dropped_out: n}} = client when n > 0 <- clients do
        {"client #{text(client.id)}: #{n} frames DROPPED because a peer reads too slowly", :yellow}
      end

    unread =
      for client <- clients, n = View.dropped_in(client), n > 0 do
        {"client #{text(client.id)}: #{n} datagrams DROPPED because they come faster than they are read",
         :yellow}
      end

    out ++ unread
  end

  defp interfaces([]), do: []

  defp interfaces(interfaces) do
    width = interfaces |> Enum.map(&String.length(&1.address)) |> Enum.max() |> min(48)

    [
      "",
      {"OPEN TO", :dim}
      | Enum.map(interfaces, &{"#{fit(text(&1.address), width)}  #{text(&1.who)}", if(&1.wide, do: :yellow)})
    ]
  end

  defp notes(%View{notes: []}), do: []
  defp notes(%View{notes: notes}), do: ["", {"LATEST EVENTS", :dim} | Enum.map(notes, &{&1, nil})]

  defp line("", _width), do: ""
  defp line({text, nil}, width), do: cut(text, width)
  defp line({text, style}, width), do: Map.fetch!(@styles, style) <> cut(text, width) <> @reset

  defp cut(text, width), do: if(String.length(text) > width, do: fit(text, width), else: text)
end
