defmodule Aerie.Console.Pages.Alarms.Page do
  @moduledoc "The alarms, those of a vehicle together: what, since when, why, what to do, and who acknowledged them."
  use Aerie.Console, :page

  alias Aerie.Fleet.Alarms
  alias Aerie.Console.Pages.Alarms.Strip
  alias Aerie.Console.Clock
  alias Aerie.Console.UI.Age
  alias Aerie.Console.Pages.Vehicle.Sections

  @impl Phoenix.LiveView
  def mount(_params, _session, socket),
    do: {:ok, socket |> assign(page_title: "Alarms") |> subscribe([]) |> load()}

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}

  defp load(socket) do
    {list, dropped} = Alarms.list(socket.assigns.gateway)
    now = System.os_time(:microsecond)
    rows = for alarm <- list, do: Map.merge(alarm, %{state: Alarms.state(alarm), age: now - alarm.since})
    assign(socket, rows: rows, dropped: dropped, may?: Strip.may?(socket.assigns.user))
  end

  # In the order of each vehicle's first alarm.
  defp groups(rows) do
    by_vehicle = Enum.group_by(rows, & &1.vehicle)
    for vehicle <- rows |> Enum.map(& &1.vehicle) |> Enum.uniq(), do: {vehicle, by_vehicle[vehicle]}
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="spread page-title">
      <h1>Alarms</h1>
      <.button :if={@may?} phx-click={JS.push("alarm-acknowledge", value: %{alarms: Enum.map(@rows, & &1.id)})} icon="check" disabled={@alarms.waiting == 0}>Acknowledge all</.button>
    </div>
    <.stale :if={@dropped > 0}>{@dropped} more alarms did not fit in this list.</.stale>
    <.empty :if={@rows == []} icon="check" title="No alarms">
      Lost vehicles and links, failsafes, batteries, fences and duplicate system ids appear here.
    </.empty>
    <div :if={@rows != []} id="alarms">
      <section
        :for={{vehicle, rows} <- groups(@rows)} :key={vehicle || "gateway"} class="alarm-group"
        aria-label={"Alarms of #{vehicle || "the gateway"}"}
      >
        <div class="spread">
          <h2>{vehicle || "Gateway"}</h2>
          <.button :if={vehicle} small icon="goto" navigate={Sections.path(vehicle, "fly")}>Go to {vehicle}</.button>
        </div>
        <ul class="stack">
          <li
            :for={row <- rows} :key={row.id} id={"alarm-#{row.id}"}
            class={["card alarm-row", Atom.to_string(row.state), Strip.kind_of(row)]}
          >
            <div class="spread">
              <h3><.badge kind={Strip.kind_of(row)}><.icon name={if row.state == :over, do: "check", else: "alert"} />{row.severity}</.badge> {row.text}</h3>
              <span class="muted"><time title={Clock.full(row.since)}>{Age.text(row.age)}</time>, {state(row)}</span>
            </div>
            <dl :if={row.why || row.mend} class="facts">
              <div :if={row.mend}><dt>What to do</dt><dd>{row.mend}</dd></div>
              <div :if={row.why}><dt>Why</dt><dd>{row.why}</dd></div>
            </dl>
            <.button
              :if={row.by == nil && @may?} small icon="check" phx-click="alarm-acknowledge"
              phx-value-alarm={row.id}
            >Acknowledge</.button>
          </li>
        </ul>
      </section>
    </div>
    """
  end

  defp state(%{by: by} = alarm) when by != nil, do: "#{word(alarm)}, acknowledged by #{by}"
  defp state(alarm), do: word(alarm)

  defp word(%{over: over}) when over != nil, do: "Cleared"
  defp word(_alarm), do: "Active"
end
