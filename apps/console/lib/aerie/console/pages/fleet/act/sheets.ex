defmodule Aerie.Console.Pages.Fleet.Act.Sheets do
  @moduledoc "The kinds of sheets by their names, and the dialog of all (`Aerie.Console.Pages.Fleet.Act.Sheet`)."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.Act.Mission.{Send, Start}
  alias Aerie.Console.Pages.Fleet.Act.{Return, Sheet, TakeOff}

  @kinds %{"take_off" => TakeOff, "return" => Return, "start" => Start, "mission" => Send}

  @doc "The names."
  @spec names() :: [String.t()]
  def names, do: Map.keys(@kinds)

  @doc "The kind of a name."
  @spec kind(name :: String.t()) :: module()
  def kind(name), do: Map.fetch!(@kinds, name)

  attr :sheet, :any, required: true
  attr :facts, :map, required: true, doc: "`t:Aerie.Console.Pages.Fleet.Act.Sheet.known/0`"
  attr :error, :string, default: nil, doc: "why the gateway has not begun it"

  @doc "The dialog of the sheet that is open; nothing without one."
  def dialog_of(%{sheet: nil} = assigns), do: ~H""

  def dialog_of(%{sheet: %{kind: kind} = sheet, facts: facts} = assigns) do
    lines = Sheet.lines(sheet, facts)

    assigns =
      assign(assigns,
        about: kind.about(),
        lines: lines,
        going: Enum.count(lines, & &1.n),
        values: Sheet.values(sheet),
        errors: Sheet.errors(sheet),
        refusal: Sheet.refusal(sheet, facts)
      )

    ~H"""
    <.dialog id={@about.id} title={"#{@about.title} #{count(length(@lines))}"} cancel="sheet_close" kind="wide">
      <form id={"#{@about.id}-form"} class="sheet-fields" phx-change="sheet_change" phx-submit="sheet_change">
        <.value
          :for={field <- Sheet.fields(@sheet)}
          sheet={@about.id}
          field={field}
          value={@values[field.name]}
          error={@errors[field.name]}
        />
      </form>
      {Sheet.extra(@sheet, assigns)}
      <ol
        class={["sheet-lines", "#{@about.id}-lines"]}
        id={"#{@about.id}-lines"}
        phx-hook={@about.in_turn? && "SheetOrder"}
        aria-label={@about.order}
      >
        <li
          :for={line <- @lines}
          :key={line.id}
          id={"#{@about.id}-#{line.id}"}
          data-id={line.id}
          draggable={@about.in_turn? && "true"}
          class={line.n == nil && "sheet-out"}
        >
          <span class="sheet-n">{line.n || "–"}</span>
          <strong>{line.id}</strong>
          <.cell :for={cell <- @sheet.kind.cells(line)} cell={cell} />
          <span class="sheet-buttons">
            <.button
              :for={{to, icon, word} <- if(@about.in_turn?, do: places(), else: [])}
              small
              icon={icon}
              label={"#{line.id} #{word}"}
              phx-click="sheet_move"
              phx-value-id={line.id}
              phx-value-to={to}
            />
            <.button :if={line[:anyway?]} small phx-click="sheet_anyway" phx-value-id={line.id}>
              Take along anyway
            </.button>
            <.button small phx-click="sheet_leave" phx-value-id={line.id}>
              {if line.n, do: "Leave out", else: "Take along"}
            </.button>
          </span>
        </li>
      </ol>
      <p class="sheet-summary">{sentences(@sheet.kind.summary(@sheet, @lines, @facts))}</p>
      <p :if={@error} class="field-error" role="alert">{@error}</p>
      <p :if={@refusal} class="field-error" role="status">{@refusal}</p>
      <:action>
        <.button phx-click="sheet_close">Cancel</.button>
        <.hold_button
          id={"#{@about.id}-go"}
          event="sheet_go"
          icon={@about.icon}
          hold_ms={1500}
          value={Sheet.shown(@sheet, @facts)}
          refusal={@refusal}
        >
          {@about.go} {@going}{if in_turn?(@about) and @going > 1, do: ", one after the other"}
        </.hold_button>
      </:action>
    </.dialog>
    """
  end

  defp in_turn?(about), do: about.in_turn? and about[:together?] != true

  defp places, do: [{"up", "chevron-up", "earlier"}, {"down", "chevron-down", "later"}]

  attr :sheet, :string, required: true
  attr :field, :map, required: true
  attr :value, :any, required: true
  attr :error, :string, required: true

  defp value(%{field: %{options: _options}} = assigns) do
    ~H"""
    <.field
      id={field_id(@sheet, @field)}
      type="select"
      name={@field.name}
      label={@field.label}
      value={@value}
      options={@field.options}
      errors={List.wrap(@error)}
    />
    """
  end

  defp value(%{field: %{range: {min, max}}} = assigns) do
    assigns = assign(assigns, min: min, max: max)

    ~H"""
    <.field
      id={field_id(@sheet, @field)}
      type="number"
      name={@field.name}
      label={@field.label}
      unit={@field.unit}
      value={@value}
      errors={List.wrap(@error)}
      min={@min}
      max={@max}
      step="any"
      inputmode="decimal"
      phx-debounce="300"
      autocomplete="off"
    />
    """
  end

  defp field_id(sheet, field), do: "#{sheet}-" <> String.replace("#{field.name}", "_", "-")

  attr :cell, :any, required: true

  defp cell(%{cell: {:readiness, state}} = assigns) do
    assigns = assign(assigns, :state, state)
    ~H"<.readiness state={@state} />"
  end

  defp cell(%{cell: {:badges, badges}} = assigns) do
    assigns = assign(assigns, :badges, Enum.filter(badges, &elem(&1, 1)))

    ~H"""
    <span :if={@badges != []} class="sheet-why">
      <.badge :for={{kind, text} <- @badges} kind={kind}>{text}</.badge>
    </span>
    """
  end

  defp cell(%{cell: {kind, text}} = assigns) do
    assigns = assign(assigns, text: text, class: %{number: "number", muted: "muted sheet-why"}[kind])
    ~H"<span class={@class}>{@text}</span>"
  end

  defp sentences(texts), do: texts |> List.wrap() |> Enum.filter(& &1) |> Enum.join(" ")

  defp count(1), do: "1 vehicle"
  defp count(n), do: "#{n} vehicles"
end
