defmodule Aerie.Console.Pages.Settings.BaseMap do
  @moduledoc "The layers of the map for admins: where they are from, what is kept, and whether their servers answer."
  use Aerie.Console, :component

  attr :layers, :list, required: true, doc: "`t:Aerie.Console.Map.Tiles.overview/0`"

  @doc "All layers."
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
    </section>
    """
  end

  defp kept(nil), do: "being counted"
  defp kept({tiles, bytes}), do: "#{tiles}, #{Float.round(bytes / 1_000_000, 1)} MB"

  defp state(%{failing: {words, seconds}}), do: "Failing: #{words}. Asked again in #{seconds} s"
  defp state(%{server?: true, fetched: 0, errors: 0}), do: "Not asked yet"
  defp state(%{server?: true}), do: "Answers"
  defp state(_file), do: "There"
end
