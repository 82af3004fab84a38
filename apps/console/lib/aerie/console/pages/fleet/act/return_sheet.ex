defmodule Aerie.Console.Pages.Fleet.Act.ReturnSheet do
  @moduledoc "The dialog of a return of several vehicles (`Aerie.Console.Pages.Fleet.Act.Return`)."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Fleet.Act.SheetParts

  alias Aerie.Console.Pages.Fleet.Act.Return

  attr :sheet, :any, required: true
  attr :facts, :map, required: true, doc: "`t:Aerie.Console.Pages.Fleet.Act.Return.facts/0` by id"
  attr :error, :string, default: nil

  @doc "The dialog."
  def return_sheet(%{sheet: sheet, facts: facts} = assigns) do
    lines = Return.lines(sheet, facts)

    assigns =
      assign(assigns,
        lines: lines,
        going: Enum.count(lines, & &1.n),
        queued: Enum.count(lines, & &1.after),
        undone: Enum.count(lines, & &1.warn),
        refusal: Return.refusal(sheet, facts),
        shown: Return.shown(sheet, facts),
        limits: Return.limits()
      )

    ~H"""
    <.dialog id="return" title={"Return #{count(length(@lines))}"} cancel="sheet_close" kind="wide">
      <form id="return-form" class="sheet-fields" phx-change="sheet_change" phx-submit="sheet_change">
        <.number
          sheet="return"
          name="base"
          label="Lowest, above home"
          unit="m"
          value={@sheet.base}
          limits={@limits.base}
        />
        <.number
          sheet="return"
          name="step"
          label="More each"
          unit="m"
          value={@sheet.step}
          limits={@limits.step}
        />
      </form>
      <ol class="sheet-lines return-lines" id="return-lines" aria-label="The nearest to its home flies lowest">
        <li :for={line <- @lines} :key={line.id} id={"return-#{line.id}"} class={line.n == nil && "sheet-out"}>
          <span class="sheet-n">{line.n || "–"}</span>
          <strong>{line.id}</strong>
          <span class="number">{height(line)}</span>
          <span class="number">{if line.home_m, do: "#{line.home_m} m away", else: "distance unknown"}</span>
          <span class="sheet-why">
            <.badge :if={line.after} kind="bad">One place with {line.after}: waits until that has landed</.badge>
            <.badge :if={line.warn} kind="warn">{line.warn}</.badge>
          </span>
          <span class="sheet-buttons"><.leave line={line} /></span>
        </li>
      </ol>
      <p class="sheet-summary">
        Each goes to its height first, then home; one that does not reach it stays where it is.
        {if @queued > 0, do: "Those that wait go on 15 s after the other landing: clear the place by then."}
        {if @undone > 0, do: "#{@undone} may leave the stack."}
      </p>
      <.errors error={@error} refusal={@refusal} />
      <:action>
        <.go sheet="return" icon="rtl" value={@shown} refusal={@refusal}>Return {@going}</.go>
      </:action>
    </.dialog>
    """
  end

  defp height(%{n: nil}), do: "left out"
  defp height(%{height: nil}), do: "own height"
  defp height(%{height: height}), do: "#{height} m"
end
