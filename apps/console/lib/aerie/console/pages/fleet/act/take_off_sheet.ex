defmodule Aerie.Console.Pages.Fleet.Act.TakeOffSheet do
  @moduledoc "The dialog of a take-off of several vehicles (`Aerie.Console.Pages.Fleet.Act.TakeOff`)."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Fleet.Act.SheetParts

  alias Aerie.Console.Pages.Fleet.Act.TakeOff

  attr :sheet, :any, required: true
  attr :facts, :map, required: true, doc: "`t:Aerie.Console.Pages.Fleet.Act.TakeOff.facts/0` by id"
  attr :error, :string, default: nil, doc: "why the gateway has not begun it"

  @doc "The dialog."
  def sheet(%{sheet: sheet, facts: facts} = assigns) do
    lines = TakeOff.lines(sheet, facts)
    nearest = TakeOff.nearest(lines, facts)
    going = Enum.count(lines, & &1.n)

    assigns =
      assign(assigns,
        lines: lines,
        nearest: nearest,
        going: going,
        refusal: TakeOff.refusal(sheet, facts),
        shown: TakeOff.shown(sheet, facts),
        limits: TakeOff.limits()
      )

    ~H"""
    <.dialog id="take-off" title={"Take off #{count(length(@lines))}"} cancel="sheet_close" kind="wide">
      <form id="take-off-form" class="sheet-fields" phx-change="sheet_change" phx-submit="sheet_change">
        <.number
          sheet="take-off"
          name="height"
          label="Height (above home)"
          unit="m"
          value={@sheet.height}
          limits={@limits.height}
        />
        <.field
          id="take-off-stacked"
          type="select"
          name="stacked"
          label="Heights"
          value={to_string(@sheet.stacked)}
          options={[{"Stacked", "true"}, {"The same for all", "false"}]}
        />
        <.number
          :if={@sheet.stacked}
          sheet="take-off"
          name="gap"
          label="More each"
          unit="m"
          value={@sheet.gap}
          limits={@limits.gap}
        />
        <.number
          sheet="take-off"
          name="interval"
          label="Between two"
          unit="s"
          value={@sheet.interval}
          limits={@limits.interval}
        />
        <.number
          sheet="take-off"
          name="above"
          label="Next one only above"
          unit="m"
          value={TakeOff.above(@sheet)}
          limits={@limits.above}
          error={TakeOff.futile(@sheet)}
        />
        <.field
          id="take-off-on-fail"
          type="select"
          name="on_fail"
          label="If one fails"
          value={@sheet.on_fail}
          options={for {value, label} <- TakeOff.on_fail(), do: {label, value}}
        />
      </form>
      <ol class="sheet-lines" id="take-off-lines" phx-hook="SheetOrder" aria-label="Order of the take-off">
        <li
          :for={line <- @lines}
          :key={line.id}
          id={"take-off-#{line.id}"}
          data-id={line.id}
          draggable="true"
          class={line.n == nil && "sheet-out"}
        >
          <span class="sheet-n">{line.n || "–"}</span>
          <strong>{line.id}</strong>
          <.readiness state={line.state} />
          <span class="muted sheet-why">{line.why}</span>
          <span class="number">{if line.n, do: "#{line.height} m", else: "left out"}</span>
          <span class="number">{line.n && "+#{line.after_s} s"}</span>
          <span class="sheet-buttons">
            <.order line={line} />
            <.button
              :if={line.n && line.state == :unknown && line.blocks}
              small
              phx-click="sheet_anyway"
              phx-value-id={line.id}
            >Take along anyway</.button>
            <.leave line={line} />
          </span>
        </li>
      </ol>
      <p class="sheet-summary">{summary(@lines)} {apart(@nearest)} {stack(@sheet, @going)}</p>
      <.errors error={@error} refusal={@refusal} />
      <:action>
        <.go sheet="take-off" icon="takeoff" value={@shown} refusal={@refusal}>
          Take off {@going}{if @going > 1, do: ", one after the other"}
        </.go>
      </:action>
    </.dialog>
    """
  end

  defp summary(lines) do
    words =
      for {state, word} <- [
            ready: "ready",
            check: "to be checked",
            unknown: "unknown",
            not_ready: "not ready"
          ],
          n = Enum.count(lines, &(&1.state == state)),
          n > 0,
          do: "#{n} #{word}"

    refused = Enum.count(lines, &(&1.n && &1.blocks))

    "#{Enum.join(words, ", ")}. " <>
      if(refused == 0, do: "Policy and firmware: allowed for all that take off.", else: "")
  end

  defp apart(nil), do: nil

  defp apart({one, other, metres}),
    do: "Nearest on the ground: #{one} and #{other}, #{Float.round(metres, 1)} m."

  defp stack(_sheet, going) when going < 2, do: nil
  defp stack(%{stacked: true, gap: gap}, _going), do: "In the stack #{gap} m apart in height."
  defp stack(_sheet, _going), do: "All at the same height."
end
