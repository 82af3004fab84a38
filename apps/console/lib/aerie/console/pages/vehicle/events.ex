defmodule Aerie.Console.Pages.Vehicle.Events do
  @moduledoc "A vehicle's events and texts as a filtered time line."
  use Aerie.Console, :component

  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Vehicle.Events.Timeline

  attr :lines, :list, required: true
  attr :level, :string, required: true
  attr :search, :string, required: true
  attr :paused, :boolean, required: true
  attr :total, :integer, required: true
  attr :via, :string, default: nil, doc: "the gateway that hears the vehicle, if this one does not"

  @doc "The events section."
  def events(assigns) do
    ~H"""
    <section aria-labelledby="events-title">
      <h2 id="events-title" class="visually-hidden">Events</h2>
      <.elsewhere :if={@via} via={@via}>Its events are shown there and are in the stream FLEET_EVENTS. This list has the events from when this gateway heard it.</.elsewhere>
      <form id="events-filter" class="row filters" phx-change="events_filter" phx-submit="events_filter">
        <.field id="events-level" name="level" type="select" label="Severity" options={levels()} value={@level} />
        <.field id="events-search" name="search" type="search" label="Search" value={@search} phx-debounce="150" autocomplete="off" />
        <.button icon={if @paused, do: "play", else: "pause"} phx-click="events_pause" aria-pressed={to_string(@paused)}>{if @paused, do: "Resume", else: "Pause"}</.button>
        <span class="muted" role="status">{count(length(@lines), @total)}</span>
      </form>
      <.empty :if={@lines == []} icon="list" title={nothing(@total, @via)}>
        Texts from the vehicle, mode changes, failsafes and other events appear here.
      </.empty>
      <.lines id="events" lines={@lines} />
    </section>
    """
  end

  defp count(total, total), do: "#{total} events"
  defp count(shown, total), do: "#{shown} of #{total} events"

  defp nothing(0, nil), do: "No events yet"
  defp nothing(0, _via), do: "This gateway has no events from it"
  defp nothing(_total, _via), do: "No match"

  attr :id, :string, required: true
  attr :lines, :list, required: true, doc: "`t:Aerie.Console.Pages.Vehicle.Events.Timeline.line/0`"

  @doc "Lines."
  def lines(assigns) do
    ~H"""
    <ol id={@id} class="timeline">
      <li :for={line <- @lines} :key={line.id} class={["event", Atom.to_string(line.tone)]}>
        <time datetime={Clock.iso(line.time)} title={Clock.full(line.time)}>{Clock.time(line.time)}</time>
        <span class="event-severity">{line.name}</span>
        <span class="event-text">{line.text}</span>
      </li>
    </ol>
    """
  end

  defp levels do
    labels = %{
      "all" => "everything",
      "notice" => "notice and worse",
      "warning" => "warning and worse",
      "error" => "error and worse"
    }

    for level <- Timeline.levels(), do: {labels[level], level}
  end
end
