defmodule Aerie.Console.Pages.Events.Page do
  @moduledoc """
  The events of the whole fleet, newest first, filtered, also those of earlier runs; new ones as they come. For
  operators the commands of the audit log stand among them (kinds `command.done` and `command.refused`), as they were
  when the page was read.
  """
  use Aerie.Console, {:page, events: [viewer: ~w(filter older newest)], costly: ~w(filter older newest)}

  alias Aerie.Access.WorkLimit
  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Replay.Marks
  alias Aerie.Console.Pages.Vehicle.Events.Timeline
  alias Aerie.Console.Pages.Vehicle.Sections
  alias Aerie.Fleet.Bridge

  @limit 100
  @spans [{"the last hour", "1"}, {"24 hours", "24"}, {"7 days", "168"}, {"30 days", "720"}]
  @hour_us 3_600_000_000
  @filter %{"vehicle" => "", "type" => "", "level" => "all", "text" => "", "hours" => "24"}

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok,
     socket
     |> assign(
       page_title: "Events",
       lines: nil,
       older: nil,
       before: nil,
       notes: [],
       reading: nil,
       again?: false
     )
     |> assign(filter: @filter)
     |> subscribe([:events])
     |> read()}
  end

  @impl Phoenix.LiveView
  def handle_event("filter", params, socket) do
    filter = for {key, default} <- @filter, into: %{}, do: {key, short(params[key], default)}
    {:noreply, socket |> assign(filter: filter, before: nil) |> read()}
  end

  def handle_event("older", _value, %{assigns: %{older: before}} = socket) when before != nil,
    do: {:noreply, socket |> assign(before: before) |> read()}

  def handle_event("newest", _value, socket), do: {:noreply, socket |> assign(before: nil) |> read()}
  def handle_event(_event, _value, socket), do: {:noreply, socket}

  defp short(text, _default) when is_binary(text), do: String.slice(text, 0, 200)
  defp short(_other, default), do: default

  @impl Phoenix.LiveView
  def handle_info(
        {:fleet, :events, event},
        %{assigns: %{before: nil, lines: [_ | _] = lines} = assigns} = socket
      ) do
    new = lines([event], assigns.filter)
    {:noreply, assign(socket, :lines, Enum.take(new ++ lines, @limit))}
  end

  def handle_info({:fleet, :events, _event}, %{assigns: %{before: nil}} = socket),
    do: {:noreply, read(socket)}

  def handle_info(:read, socket), do: {:noreply, read(socket)}

  def handle_info({ref, answer}, %{assigns: %{reading: ref}} = socket) do
    Process.demonitor(ref, [:flush])
    socket = assign(socket, :reading, nil)

    case answer do
      {:ok, found} ->
        socket = assign(socket, found)
        {:noreply, if(socket.assigns.again?, do: read(socket), else: socket)}

      {:busy, seconds} ->
        Process.send_after(self(), :read, seconds * 1000)
        {:noreply, socket}
    end
  end

  def handle_info(_stray, socket), do: {:noreply, socket}

  # In a task, because a day of a large fleet is many events. What is asked meanwhile is read afterwards.
  defp read(%{assigns: %{reading: ref}} = socket) when ref != nil, do: assign(socket, :again?, true)

  defp read(%{assigns: %{gateway: gateway, user: user, filter: filter, before: before}} = socket) do
    if connected?(socket) do
      task =
        Task.async(fn ->
          WorkLimit.run(gateway, :read, {:name, user.name}, fn -> page(gateway, user, filter, before) end)
        end)

      assign(socket, reading: task.ref, again?: false)
    else
      socket
    end
  end

  defp page(gateway, user, filter, before) do
    now = System.os_time(:microsecond)
    from = now - hours(filter)
    to = before || now
    %{events: events, cut: cut, problem: problem} = Bridge.past_events(gateway, from, to)

    commands =
      for %{vehicle: id} = mark when id != nil <- Marks.commands(gateway, user, from, to), do: line(mark)

    lines = lines(events, filter) ++ wanted(commands, filter)
    {shown, more} = lines |> Enum.sort_by(& &1.time, :desc) |> Enum.split(@limit)

    notes = [
      problem && "Events of earlier runs are missing: #{problem}",
      cut > 0 && "#{cut} older events of this time are not searched"
    ]

    %{
      lines: shown,
      older: if(more != [], do: List.last(shown).time - 1),
      notes: Enum.filter(notes, &is_binary/1)
    }
  end

  defp hours(%{"hours" => text}) do
    case Integer.parse(text) do
      {hours, ""} when hours in 1..720 -> hours * @hour_us
      _other -> 24 * @hour_us
    end
  end

  # A refusal is a notice: it says nothing of the vehicle's state.
  defp line(%{kind: kind, record: record} = mark) do
    more =
      for {name, value} when value != nil <- [{"rule", mark[:rule]}, {"by", mark.who}], do: "#{name} #{value}"

    Timeline.named(%{
      id: "record-#{record}",
      record: record,
      vehicle: mark.vehicle,
      time: round(mark.at * 1_000_000),
      type: "command.#{kind}",
      severity: if(kind == "done", do: 6, else: 5),
      text: Enum.join([mark.text | more], ", ")
    })
  end

  # The oldest event comes first in `events`.
  defp lines(events, filter), do: events |> Enum.reverse() |> Stream.map(&Timeline.line/1) |> wanted(filter)

  defp wanted(lines, %{"vehicle" => vehicle, "type" => type, "level" => level, "text" => text}) do
    lines
    |> Stream.filter(&(String.contains?(&1.vehicle, vehicle) and String.contains?(&1.type, type)))
    |> Timeline.keep(level, text)
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <h1 class="page-title">Events</h1>
    <form id="events-filter" class="tools" phx-change="filter" phx-submit="filter" role="search">
      <.field
        :for={{name, label} <- [{"vehicle", "Vehicle"}, {"type", "Kind"}, {"text", "Text"}]}
        id={"events-#{name}"}
        name={name}
        label={label}
        type="search"
        value={@filter[name]}
        phx-debounce="500"
        autocomplete="off"
      />
      <.field
        id="events-level"
        name="level"
        label="Severity"
        type="select"
        value={@filter["level"]}
        options={levels()}
      />
      <.field id="events-hours" name="hours" label="Time" type="select" value={@filter["hours"]} options={spans()} />
    </form>
    <p :for={note <- @notes} class="muted">{note}</p>
    <.loading :if={@lines == nil} />
    <.empty :if={@lines == []} icon="list" title="No event matches" />
    <.data_table
      :if={@lines not in [nil, []]}
      id="events"
      label="Events of the fleet"
      rows={@lines}
      row_id={&"e-#{&1.id}"}
    >
      <:col :let={line} label="Time">
        <.link navigate={replay(line)} title="Show this second in the replay">{Clock.stamp(line.time)}</.link>
      </:col>
      <:col :let={line} label="Vehicle">
        <.link navigate={Sections.path(line.vehicle, "events")}>{line.vehicle}</.link>
      </:col>
      <:col :let={line} label="Severity"><.badge kind={kind(line.tone)}>{line.name}</.badge></:col>
      <:col :let={line} label="Kind">{line.type}</:col>
      <:col :let={line} label="Text" class="grow">
        {line.text}
        <.link :if={line[:record]} navigate={"/audit?record=#{line.record}"}>Audit, record {line.record}</.link>
      </:col>
    </.data_table>
    <div class="row section">
      <.button :if={@before} phx-click="newest">Newest</.button>
      <.button :if={@older} phx-click="older" disabled={@reading != nil}>Older</.button>
      <span :if={@before} class="muted">Older events: not updated live</span>
    </div>
    """
  end

  defp replay(%{time: time, vehicle: vehicle}),
    do:
      "/replay?" <>
        URI.encode_query(at: time |> Clock.iso() |> String.replace(~r/\.\d+Z/, "Z"), vehicles: vehicle)

  defp kind(:bad), do: "bad"
  defp kind(:warn), do: "warn"
  defp kind(:plain), do: "plain"

  defp levels,
    do:
      for(level <- Timeline.levels(), do: {if(level == "all", do: level, else: "#{level} and worse"), level})

  defp spans, do: @spans
end
