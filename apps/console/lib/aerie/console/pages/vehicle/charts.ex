defmodule Aerie.Console.Pages.Vehicle.Charts do
  @moduledoc "Charts of chosen fields. The page's address contains the choice, so that a reload or a link shows the same."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Vehicle.Charts.{MessageSeries, Series}

  attr :vehicle, :string, required: true
  attr :series, :list, required: true, doc: "`t:Aerie.Console.Pages.Vehicle.Charts.Series.t/0`"
  attr :heard, :list, required: true, doc: "names of messages"

  attr :message, :string,
    required: true,
    doc: "the one whose fields are offered, empty for the fields of the state"

  attr :via, :string, default: nil, doc: "the gateway that hears the vehicle, if this one does not"
  attr :path, :any, required: true, doc: "a function of keys: the address of the page with these"

  @doc "The charts section."
  def charts(assigns) do
    ~H"""
    <section aria-labelledby="charts-title">
      <h2 id="charts-title" class="visually-hidden">Charts</h2>
      <.elsewhere :if={@via} via={@via}>Its state can be charted here, its messages there.</.elsewhere>
      <form id="chart-add" class="row filters" phx-change="chart_add" phx-submit="noop">
        <.field id="chart-message" name="message" type="select" label="Source" options={[{"vehicle state", ""} | Enum.map(@heard, &{&1, &1})]} value={@message} />
        <.field id="chart-field" name="key" type="select" label="Add a field" options={options(@series, @message)} value="" disabled={length(@series) >= Series.max()} />
      </form>
      <nav class="row chips" aria-label="Often needed">
        <.button
          :for={{name, keys} <- Series.presets()} small patch={@path.(keys)}
          aria-current={if(keys(@series) == keys, do: "true")}
        >{name}</.button>
        <span class="hint">Last 10 minutes, where the gateway keeps tracks; “from now on”: from when you opened this page, because the gateway does not record the field.</span>
      </nav>
      <ul class="row chips" aria-label="Charted fields">
        <li :for={one <- @series} :key={one.key} class="chip" title={one.meaning}>
          {one.label} <small :if={not Series.tracked?(one)} class="muted">from now on</small>
          <.link patch={@path.(List.delete(keys(@series), one.key))} aria-label={"Remove #{one.label}"}><.icon name="x" /></.link>
        </li>
      </ul>
      <.empty
        :if={@series == []} icon="chart" title="No field chosen"
      >Choose a group above, or add up to {Series.max()} fields one by one.</.empty>
      <div id="charts" class="card" hidden={@series == []} phx-hook="Chart" data-vehicle={@vehicle} data-series={JSON.encode!(drawn(@series))}>
        <div id="charts-place" phx-update="ignore" data-plots></div>
      </div>
    </section>
    """
  end

  defp keys(series), do: Enum.map(series, & &1.key)
  defp drawn(series), do: Enum.map(series, &Map.take(&1, [:key, :label, :unit]))

  defp options(series, message) do
    offered = if message == "", do: Series.all(), else: MessageSeries.of_message(message)
    [{"choose", ""} | for(one <- offered, one not in series, do: {labelled(one), one.key})]
  end

  defp labelled(%{unit: "", label: label}), do: label
  defp labelled(one), do: "#{one.label} (#{one.unit})"
end
