defmodule Aerie.Console.Pages.Fleet.Act.Mission.StartSheet do
  @moduledoc "The dialog that starts missions one after the other (`Aerie.Console.Pages.Fleet.Act.Mission.Start`)."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Fleet.Act.SheetParts

  alias Aerie.Console.Pages.Fleet.Act.Mission.Start

  attr :sheet, :any, required: true
  attr :facts, :map, required: true, doc: "`t:Aerie.Console.Pages.Fleet.Act.Mission.Start.facts/0` by id"
  attr :error, :string, default: nil

  @doc "The dialog."
  def start_sheet(%{sheet: sheet, facts: facts} = assigns) do
    lines = Start.lines(sheet, facts)

    assigns =
      assign(assigns,
        lines: lines,
        going: Enum.count(lines, & &1.n),
        refusal: Start.refusal(sheet, facts),
        shown: Start.shown(sheet, facts),
        limits: Start.limits()
      )

    ~H"""
    <.dialog id="start" title={"Start the missions of #{count(length(@lines))}"} cancel="sheet_close" kind="wide">
      <form id="start-form" class="sheet-fields" phx-change="sheet_change" phx-submit="sheet_change">
        <.number
          sheet="start"
          name="interval"
          label="Between two"
          unit="s"
          value={@sheet.interval}
          limits={@limits.interval}
        />
      </form>
      <ol class="sheet-lines start-lines" id="start-lines" phx-hook="SheetOrder" aria-label="Order of the starts">
        <li
          :for={line <- @lines}
          :key={line.id}
          id={"start-#{line.id}"}
          data-id={line.id}
          draggable="true"
          class={line.n == nil && "sheet-out"}
        >
          <span class="sheet-n">{line.n || "–"}</span>
          <strong>{line.id}</strong>
          <span>{items(line.items)}</span>
          <span class="number">{if line.n, do: "+#{line.after_s} s", else: "left out"}</span>
          <span class="sheet-buttons"><.order line={line} /><.leave line={line} /></span>
        </li>
      </ol>
      <p class="sheet-summary">
        Each begins when the one before flies its mission. If one fails, the others do not begin. Whether the ways come
        near to each other is not compared.
      </p>
      <.errors error={@error} refusal={@refusal} />
      <:action>
        <.go sheet="start" icon="play" value={@shown} refusal={@refusal}>
          Start {@going}{if @going > 1, do: ", one after the other"}
        </.go>
      </:action>
    </.dialog>
    """
  end

  defp items(nil), do: "mission not known"
  defp items(0), do: "no mission"
  defp items(1), do: "1 item"
  defp items(n), do: "#{n} items"
end
