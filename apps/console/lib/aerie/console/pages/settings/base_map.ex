defmodule Aerie.Console.Pages.Settings.BaseMap do
  @moduledoc "The layers of the map for admins: where they are from, what is kept, and whether their servers answer."
  use Aerie.Console, :component

  alias Aerie.Console.Clock

  attr :layers, :list, required: true, doc: "`t:Aerie.Console.Map.Tiles.overview/0`"

  attr :areas, :list, required: true, doc: "`t:Aerie.Console.Map.Tiles.Area.Prepared.t/0`"

  @doc "All layers, and the areas that were prepared."
  def base_map(assigns) do
    ~H"""
    <section class="card" aria-labelledby="map-title">
      <h2 id="map-title">Map</h2>
      <p class="muted">
        The button <em>Base map</em> on any map adds and removes files, and prepares an area. Servers are declared in
        the configuration (<code>console.map.layers</code>).
      </p>
      <.empty :if={@layers == []} icon="map" title="No base map" />
      <.data_table
        :if={@layers != []}
        id="map-layers"
        label="Layers of the map"
        rows={@layers}
        row_id={&"layer-#{&1.id}"}
      >
        <:col :let={layer} label="Layer"><strong>{layer.name}</strong></:col>
        <:col :let={layer} label="From">{layer.from}</:col>
        <:col :let={layer} label="Kept tiles">{if layer.server?, do: kept(layer.held)}</:col>
        <:col :let={layer} label="Fetched">{if layer.server?, do: layer.fetched}</:col>
        <:col :let={layer} label="Errors">{if layer.server?, do: layer.errors}</:col>
        <:col :let={layer} label="State">{state(layer)}</:col>
        <:col :let={layer} label="Actions">
          <.button
            :if={layer.server?}
            small
            icon="trash"
            phx-click="ask"
            phx-value-what="clear"
            phx-value-name={layer.id}
          >Empty</.button>
        </:col>
      </.data_table>
      <p class="hint">Counts are since the gateway was started.</p>
      <.data_table
        :if={@areas != []}
        id="map-areas"
        label="Areas that were prepared"
        rows={@areas}
        row_id={&"area-#{&1.at}"}
      >
        <:col :let={area} label="Prepared area">{place(area.box)}</:col>
        <:col :let={area} label="Layer">{area.layer}</:col>
        <:col :let={area} label="Down to zoom">{area.zoom}</:col>
        <:col :let={area} label="Tiles">{area.tiles}</:col>
        <:col :let={area} label="On">{Clock.full(area.at)}</:col>
        <:col :let={area} label="Actions">
          <.button small icon="trash" phx-click="forget-area" phx-value-at={area.at}>Forget</.button>
        </:col>
      </.data_table>
      <p :if={@areas != []} class="hint">
        A dashed line on the map shows each. Its tiles stay until the layer is emptied, or others need the room.
      </p>
    </section>
    """
  end

  # The middle of the box.
  defp place([west, south, east, north]),
    do: "#{Float.round((south + north) / 2, 4)}, #{Float.round((west + east) / 2, 4)}"

  defp kept(nil), do: "being counted"
  defp kept({tiles, bytes}), do: "#{tiles}, #{Float.round(bytes / 1_000_000, 1)} MB"

  defp state(%{failing: {words, seconds}}), do: "Failing: #{words}. Asked again in #{seconds} s"
  defp state(%{server?: true, fetched: 0, errors: 0}), do: "Not asked yet"
  defp state(%{server?: true}), do: "Answers"
  defp state(_file), do: "There"
end
