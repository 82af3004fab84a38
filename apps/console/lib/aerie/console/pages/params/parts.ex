defmodule Aerie.Console.Pages.Params.Parts do
  @moduledoc "The parts of the page of parameters."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Params.{Listing, Reading}

  attr :vehicles, :list, required: true
  attr :vehicle, :string, required: true, doc: "nil for none"
  attr :components, :list, required: true, doc: "`Aerie.Console.Pages.Params.Components`"
  attr :component, :integer, required: true, doc: "nil for the autopilot"
  attr :described, :boolean, required: true, doc: "the descriptions were read"
  attr :filter, :map, required: true
  attr :reading, :map, required: true, doc: "nil for none"
  attr :table, :map, required: true, doc: "nil for none"
  attr :file, :map, required: true, doc: "nil for none"
  attr :via, :string, required: true, doc: "the gateway that hears the vehicle; nil: this one"

  @doc "The choice of vehicle and of what is shown, and the files."
  def toolbar(assigns) do
    ~H"""
    <div class="params-tools" id="params-tools" phx-hook="ParamsFile">
      <form id="params-vehicle" class="row" phx-change="vehicle" phx-submit="vehicle">
        <.field id="params-vehicle-choice" name="vehicle" type="select" label="Vehicle" options={[{"choose", ""} | Enum.map(@vehicles, &{&1, &1})]} value={@vehicle} />
        <.field :if={@components != []} id="params-component" name="component" type="select" label="Component" options={[{"autopilot", ""} | @components]} value={@component} />
      </form>
      <form :if={@table} id="params-filter" class="row filters" phx-change="filter" phx-submit="filter">
        <.field id="params-search" name="search" type="search" label="Search" value={@filter.search} phx-debounce="150" autocomplete="off" />
        <.field id="params-only" name="only" type="select" label="Show" options={choices(@file)} value={@filter.only} />
      </form>
      <div :if={@vehicle} class="row">
        <.button icon="refresh" phx-click="read" disabled={@reading != nil}>Read</.button>
        <.button :if={@table && @component == nil && @via == nil && not @described} icon="info" phx-click="describe" disabled={@reading != nil} title="Reads what the vehicle says about its parameters, once for each firmware">Descriptions</.button>
        <label :if={@table && @component == nil} class="button" for="params-open"><.icon name="upload" />Open file…<input id="params-open" class="visually-hidden" type="file" accept=".param,.params,.parm,.txt" /></label>
        <.button :if={@table && @component == nil} icon="download" phx-click="save" phx-value-format="param">Save as .param</.button>
        <.button :if={@table && @component == nil} icon="download" phx-click="save" phx-value-format="params">Save as .params</.button>
      </div>
    </div>
    """
  end

  defp choices(nil), do: [{"all", "all"}, {"changed from the default", "changed"}]
  defp choices(_file), do: choices(nil) ++ [{"differs from the file", "differs"}]

  attr :reading, :map, required: true

  @doc "The progress of reading."
  def progress(assigns) do
    ~H"""
    <div class="notice info" role="status" id="params-progress">
      <span class="spinner small"></span>
      <span>Reading {if @reading.what == :descriptions, do: "descriptions", else: "parameters"}</span>
      <.meter value={Reading.share(@reading)} label="Parameters read" text={count(@reading.progress)} />
      <.button small={true} icon="x" phx-click="stop_reading">Stop</.button>
    </div>
    """
  end

  defp count(%{"done" => done, "total" => total}) when is_integer(done) and is_integer(total),
    do: "#{done} of #{total}"

  defp count(_unknown), do: nil

  attr :file, :map, required: true
  attr :vehicle, :string, required: true
  attr :differing, :list, required: true
  attr :cautions, :list, required: true, doc: "`Aerie.Console.Pages.Params.Listing.cautions/2`"
  attr :missing, :list, required: true
  attr :able, :boolean, required: true
  attr :via, :string, required: true, doc: "the gateway that hears the vehicle; nil: this one"

  @doc "The changes that an opened file would make."
  def file(assigns) do
    ~H"""
    <section class="card" id="params-file" aria-labelledby="params-file-title">
      <div class="spread">
        <h2 id="params-file-title">{@file.name}</h2>
        <.button kind="quiet" small={true} icon="x" label="Close the file" phx-click="close_file" />
      </div>
      <p>{length(@file.entries)} parameters, {length(@differing)} differ from the vehicle{missing(@missing)}.</p>
      <p :for={remark <- @file.remarks} class="notice warn"><.icon name="alert" /> <span>{remark}</span></p>
      <.cautions :if={@able and @differing != [] and @via == nil} texts={@cautions} />
      <.hold_button :if={@able and @differing != [] and @via == nil} id="params-load" event="command" icon="upload" kind={kind(@cautions)} hold_ms={hold(@cautions)} value={%{shown: Listing.target(@vehicle, nil, @differing)}} phx-value-type="load">Set the {length(@differing)} that differ</.hold_button>
      <p :if={not @able} class="hint">Setting parameters needs the permission maintain or pilot.</p>
    </section>
    """
  end

  defp missing([]), do: ""
  defp missing(names), do: "; the vehicle does not have #{Listing.listed(names)}"

  attr :rows, :list, required: true, doc: "`t:Aerie.Console.Pages.Params.Listing.row/0`"
  attr :total, :integer, required: true
  attr :path, :any, required: true, doc: "a function of a name: the address with it open"
  attr :file, :map, required: true

  @doc "The table."
  def table(assigns) do
    ~H"""
    <p class="muted" role="status">{count_text(@total)}</p>
    <.empty :if={@rows == []} icon="search" title="No parameter matches" />
    <.data_table :if={@rows != []} id="params" label="Parameters" rows={@rows} row_id={&"param-#{&1.name}"} row_class={&(&1.changed && "changed")}>
      <:col :let={row} label="Name"><.link patch={@path.(row.name)} class="mono">{row.name}</.link><span :if={row.about[:short]} class="muted param-about">{row.about.short}</span></:col>
      <:col :let={row} label="Value" number={true}><strong>{row.value}</strong>{unit(row.about)}</:col>
      <:col :let={row} label="Default" number={true}>{row.default || "–"}</:col>
      <:col :let={row} label={if @file, do: "File", else: "Type"} number={@file != nil}>{if @file, do: row.file || "", else: row.type}</:col>
      <:col :let={row} label="State"><.badge :if={row.changed} kind="info">changed</.badge><.badge :if={not row.exact} kind="warn" title="The vehicle's float cannot represent all digits">inexact</.badge></:col>
    </.data_table>
    """
  end

  defp unit(%{unit: unit}) when is_binary(unit) and unit != "", do: " " <> unit
  defp unit(_unknown), do: ""

  defp count_text(1), do: "1 parameter"

  defp count_text(total) do
    if total > Listing.max(),
      do: "The first #{Listing.max()} of #{total}; search for the others",
      else: "#{total} parameters"
  end

  attr :row, :map, required: true
  attr :vehicle, :string, required: true
  attr :component, :integer, required: true, doc: "nil for the autopilot"
  attr :able, :boolean, required: true
  attr :cautions, :list, required: true, doc: "`Aerie.Console.Pages.Params.Listing.cautions/2`"
  attr :given, :string, required: true, doc: "a value that the address proposes; nil for none"
  attr :error, :string, required: true

  @doc "The form that sets one parameter. Its button is held: what bounds or protects a vehicle may be behind any name."
  def editor(assigns) do
    ~H"""
    <.dialog id="param-editor" title={@row.name} cancel="close_param">
      <p :if={@row.about} id="param-about">{@row.about.long || @row.about.short}</p>
      <dl class="facts">
        <div class="fact"><dt>Value</dt><dd><strong>{@row.value}</strong>{unit(@row.about)}</dd></div>
        <div class="fact"><dt>Default</dt><dd>{@row.default || "not reported by the vehicle"}</dd></div>
        <div class="fact"><dt>Type</dt><dd>{@row.type}</dd></div>
        <div :if={@row.file} class="fact"><dt>In the file</dt><dd>{@row.file}</dd></div>
        <div :for={{label, text} <- about(@row.about)} class="fact"><dt>{label}</dt><dd>{text}</dd></div>
      </dl>
      <form :if={@able} id="param-form" class="control" phx-hook="CommandForm" phx-auto-recover="ignore">
        <input type="hidden" name="name" value={@row.name} />
        <.field id="param-value" name="value" label="New value" inputmode={if @row.type == "text", do: "text", else: "decimal"} autocomplete="off" value={@given || @row.file || @row.value} errors={List.wrap(@error)} autofocus={true} />
        <.cautions texts={@cautions} />
        <.hold_button id="param-set" event="command" kind={kind(@cautions)} hold_ms={hold(@cautions)} value={%{shown: Listing.target(@vehicle, @component, @row.value)}} phx-value-type="set">Set</.hold_button>
      </form>
      <p :if={not @able} class="hint">Setting parameters needs the permission maintain or pilot.</p>
    </.dialog>
    """
  end

  attr :texts, :list, required: true

  defp cautions(assigns) do
    ~H"""
    <p :for={text <- @texts} class="notice warn"><.icon name="alert" /> <span>{text}</span></p>
    """
  end

  defp kind([]), do: "primary"
  defp kind(_cautions), do: "danger"

  defp hold([]), do: 800
  defp hold(_cautions), do: 1500

  defp about(nil), do: []

  defp about(about) do
    [
      {"Range", range(about)},
      {"Choices",
       list(for %{value: value, text: text} <- about.values, do: "#{Listing.text(value)} #{text}")},
      {"Bits", list(for %{bit: bit, text: text} <- about.bits, do: "#{bit} #{text}")},
      {"Takes effect", if(about.reboot_required, do: "after a reboot")}
    ]
    |> Enum.reject(fn {_label, text} -> text in [nil, ""] end)
  end

  defp range(%{min: nil, max: nil}), do: nil
  defp range(%{min: min, max: nil}), do: "from #{Listing.text(min)}"
  defp range(%{min: nil, max: max}), do: "up to #{Listing.text(max)}"
  defp range(%{min: min, max: max}), do: "#{Listing.text(min)} to #{Listing.text(max)}"

  # A list of channels or functions can be long.
  defp list(items) when length(items) > 40, do: list(Enum.take(items, 40) ++ ["…"])
  defp list(items), do: Enum.join(items, ", ")
end
