defmodule Aerie.Console.Pages.Vehicle.LinkTable do
  @moduledoc "The links that hear a vehicle, with loss and round trip; its clock, and which station keeps its ground-station failsafe quiet."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Vehicle.GroupCard

  alias Aerie.Console.Pages.Vehicle.View

  attr :view, View, required: true
  attr :rows, :list, required: true, doc: "`t:Aerie.Console.Pages.Vehicle.LinkTable.Links.row/0`"

  @doc "The links section."
  def links(assigns) do
    assigns = assign(assigns, clock: assigns.view.vehicle.clock || %{}, gcs: assigns.view.vehicle.gcs)

    ~H"""
    <section aria-labelledby="links-title" class="stack">
      <h2 id="links-title" class="visually-hidden">Links</h2>
      <.elsewhere :if={@view.vehicle.via} via={@view.vehicle.via}>Its links and its clock are shown there.</.elsewhere>
      <.empty :if={@rows == [] && @view.vehicle.via == nil} icon="link-off" title="No link hears this vehicle" />
      <.data_table :if={@rows != []} id="vehicle-links" label="Links of this vehicle" rows={@rows} row_id={&"link-#{&1.id}"}>
        <:col :let={row} label="Link"><strong>{row.id}</strong> <span class="muted">{row.url}</span></:col>
        <:col :let={row} label="State"><.badge kind={kind(row.status)}>{row.status}</.badge></:col>
        <:col :let={row} label="Lost" number={true}>{loss(row)}</:col>
        <:col :let={row} label="Round trip" number={true}>{if row.round_trip_ms, do: "#{round(row.round_trip_ms)} ms", else: "–"}</:col>
        <:col :let={row} label="Score" number={true}>{View.number(row.score, 0)}</:col>
        <:col :let={row} label="Use">{use_of(row)}</:col>
      </.data_table>
      <div class="cards">
        <.facts id="hearing" title="Reception" view={@view} group={:link} fields={[frames_per_s: "Frames", bytes_per_s: "Bytes"]} />
        <section :if={@view.vehicle.via == nil} class="card">
          <h2>Clock</h2>
          <dl class="facts">
            <div class="fact"><dt>Round trip</dt><dd>{ms(@clock[:rtt_us])}</dd></div>
            <div class="fact"><dt>Accurate to</dt><dd>{ms(@clock[:error_us])}</dd></div>
            <div class="fact"><dt>Up</dt><dd>{boot(@view.vehicle.time_boot_ms)}</dd></div>
          </dl>
        </section>
        <section :if={@gcs} class="card">
          <h2>Ground station failsafe</h2>
          <p>{station(@gcs)}</p>
        </section>
      </div>
    </section>
    """
  end

  defp kind(:up), do: "ok"
  defp kind(:idle), do: "warn"
  defp kind(_down), do: "bad"

  defp loss(%{loss: nil}), do: "–"
  defp loss(row), do: "#{View.number(row.loss * 100, 2)} % (#{row.lost})"

  defp use_of(%{carries: true}), do: "sends and receives"
  defp use_of(%{carries: false}), do: "receives, standby"
  defp use_of(%{latest: true}), do: "received last"
  defp use_of(_row), do: ""

  defp ms(nil), do: "–"
  defp ms(us), do: "#{View.number(us / 1000, 1)} ms"

  defp boot(nil), do: "–"
  defp boot(ms), do: Aerie.Console.UI.Age.text(ms * 1000)

  defp station(%{enabled?: false}), do: "Its ground station failsafe is off."
  defp station(%{quiet?: true}), do: "The vehicle hears its ground station."

  defp station(%{quiet?: false}),
    do: "The vehicle does not hear its ground station: its failsafe is active or about to start."

  defp station(_unknown), do: "Not known which ground station it listens to."
end
