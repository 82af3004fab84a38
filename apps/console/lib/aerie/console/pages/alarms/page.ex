defmodule Aerie.Console.Pages.Alarms.Page do
  @moduledoc "The page of all alarms: which vehicle, what, how old, and who has acknowledged them."
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
    <.data_table :if={@rows != []} id="alarms" label="Alarms" rows={@rows} row_id={&"alarm-#{&1.id}"} row_class={&"alarm-row #{&1.state}"}>
      <:col :let={row} label="Severity"><.badge kind={Strip.kind_of(row)}>{row.severity}</.badge></:col>
      <:col :let={row} label="Vehicle"><.link :if={row.vehicle} navigate={Sections.path(row.vehicle, "fly")}>{row.vehicle}</.link></:col>
      <:col :let={row} label="What" class="grow">{row.text}</:col>
      <:col :let={row} label="Age" number><time title={Clock.full(row.since)}>{Age.text(row.age)}</time></:col>
      <:col :let={row} label="State">{state(row)}</:col>
      <:col :let={row} label="Acknowledged by">
        <span :if={row.by}>{row.by}</span>
        <.button :if={row.by == nil && @may?} small phx-click="alarm-acknowledge" phx-value-alarm={row.id}>Acknowledge</.button>
      </:col>
    </.data_table>
    """
  end

  defp state(%{over: over}) when over != nil, do: "Cleared"
  defp state(_alarm), do: "Active"
end
