defmodule Aerie.Console.Pages.Operations.Strip do
  @moduledoc """
  Operations that run or wait for somebody, at the foot of every page, and *Abort all* at the head. An operator who did
  not begin one may stop and abort it; a viewer looks on.
  """
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Vehicle.Sections
  alias Aerie.Control.Policy.Roles

  attr :rows, :list,
    required: true,
    doc: "of each operation: the answer of the fleet, its line, its words and how many more there are"

  attr :user, :map, required: true

  @doc "The strip; nothing without operations."
  def operation_strip(assigns) do
    ~H"""
    <section :if={@rows != []} id="operation-strip" class="operation-strip" aria-label="Operations">
      <div :for={row <- @rows} id={"operation-#{row.id}"} class="operation-row">
        <details
          class="operation-vehicles"
          id={"operation-vehicles-#{row.id}"}
          phx-mounted={JS.ignore_attributes("open")}
        >
          <summary>
            <.icon name="chevron-up" />
            <span role="status">{row.line}</span>
          </summary>
          <ul>
            <li :for={word <- row.listed}>
              <.link navigate={Sections.path(word.vehicle, "fly")}>{word.vehicle}</.link>
              <.badge kind={word.kind}>{word.text}</.badge>
            </li>
            <li :if={row.more > 0} class="muted">and {row.more} more</li>
          </ul>
        </details>
        <.badge :if={row.outside} kind="warn">{row.outside}</.badge>
        <progress max={row.all} value={row.over} aria-label={row.line}>{row.over} of {row.all}</progress>
        <.act :if={may?(@user)} row={row} mine={row.source == @user.name} />
      </div>
    </section>
    """
  end

  attr :row, :map, required: true
  attr :mine, :boolean, required: true

  defp act(assigns) do
    ~H"""
    <span class="operation-act">
      <.button
        :if={@row.state == "running" and @row.waiting > 0 and @mine}
        small
        icon="pause"
        phx-click="operation-pause"
        phx-value-operation={@row.id}
      >
        Pause
      </.button>
      <.hold_button
        :if={@row.waiting > 0 and continues?(@row, @mine)}
        id={"operation-continue-#{@row.id}"}
        event="operation-continue"
        class="small"
        value={%{operation: @row.id, waiting: @row.waiting}}
      >
        Continue with {@row.waiting}
      </.hold_button>
      <.button :for={words <- stop(@row)} small phx-click="operation-stop" phx-value-operation={@row.id}>
        {words}
      </.button>
      <.button
        :if={@row.over?}
        kind="quiet"
        icon="x"
        label={"Close #{@row.line}"}
        phx-click="operation-close"
        phx-value-operation={@row.id}
      />
      <.hold_button
        :for={{command, words} <- abort(@row)}
        id={"operation-abort-#{@row.id}"}
        event="operation-abort"
        kind="danger"
        class="small"
        value={%{operation: @row.id, command: command}}
      >
        {words}
      </.hold_button>
    </span>
    """
  end

  attr :flying, :integer, required: true, doc: "vehicles in the air that are the user's or nobody's"
  attr :user, :map, required: true

  @doc "*Abort all*, while one of the user's vehicles or of nobody's is in the air."
  def abort_all(assigns) do
    ~H"""
    <div :if={@flying > 0 and may?(@user)} id="abort-all" class="abort-all" role="group" aria-label="Abort all">
      <.hold_button
        id="abort-hold"
        event="abort-all"
        kind="danger"
        icon="hold"
        hold_ms={1500}
        shortcut="Shift+Escape"
        value={%{command: "hold"}}
      >
        Hold {@flying} <span class="wide-only">in the air</span>
      </.hold_button>
      <details class="menu" id="abort-menu" phx-mounted={JS.ignore_attributes("open")}>
        <summary aria-label="Abort all in another way"><.icon name="chevron-down" /></summary>
        <div class="menu-list">
          <.other type="rtl">Return all {@flying}, each at its height</.other>
          <.other type="land">Land all {@flying} where they are</.other>
        </div>
      </details>
    </div>
    """
  end

  attr :type, :string, required: true
  slot :inner_block, required: true

  defp other(assigns) do
    ~H"""
    <.hold_button
      id={"abort-#{@type}"}
      event="abort-all"
      kind="danger"
      icon={@type}
      hold_ms={1500}
      value={%{command: @type}}
    >
      {render_slot(@inner_block)}
    </.hold_button>
    """
  end

  defp stop(%{state: state}) when state in ~w(halted interrupted), do: ["Leave"]

  defp stop(%{state: state, waiting: waiting, up?: up?}) when state in ~w(running paused) and waiting > 0,
    do: ["Stop: the rest #{if up?, do: "stays on the ground", else: "does not begin"}"]

  defp stop(_over), do: []

  # Those that were sent up come back, and those on their way home stop where they are.
  defp abort(%{then: nil, up?: true, begun: begun}) when begun > 0, do: [{"rtl", "Abort: return all"}]
  defp abort(%{then: nil, up?: false, home?: true, over?: false}), do: [{"hold", "Abort: hold all"}]
  defp abort(_row), do: []

  defp continues?(%{state: "paused"}, mine?), do: mine?
  defp continues?(%{state: state}, _mine?), do: state in ~w(halted interrupted)

  defp may?(user), do: Roles.at_least?(user.role, :operator)
end
