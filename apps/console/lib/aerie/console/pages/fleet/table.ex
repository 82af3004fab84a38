defmodule Aerie.Console.Pages.Fleet.Table do
  @moduledoc """
  The table of vehicles. The hook `FleetTable` selects with mouse and keyboard: arrows move, Space selects, Shift a range, Ctrl+A all,
  Escape none, Enter opens.
  """
  use Aerie.Console, :component

  alias Aerie.Vehicle.Firmware
  alias Aerie.Console.Pages.Fleet.Filter
  alias Aerie.Console.Pages.Fleet.Board.Row

  attr :rows, :list, required: true
  attr :heads, :any, required: true, doc: "of `heads/1`"
  attr :selection, :map, required: true
  attr :filter, Filter, required: true

  @doc "The table. Its rows are keyed by vehicle, so that a row that moves is not rendered again."
  def vehicles(assigns) do
    first = assigns.selection.anchor || List.first(assigns.rows).id
    assigns = assign(assigns, :first, first)

    ~H"""
    <div class="table-box fleet-table" id="fleet-table" phx-hook="FleetTable">
      <table class="table" role="grid" aria-label="Vehicles" aria-multiselectable="true">
        <colgroup>
          <col class="fleet-col-check" /><col class="fleet-col-name" /><col class="fleet-col-state" />
          <col class="fleet-col-problems" /><col class="fleet-col-mode" /><col class="fleet-col-battery" />
          <col class="fleet-col-gps" /><col class="fleet-col-height" /><col class="fleet-col-speed" />
          <col class="fleet-col-link" />
        </colgroup>
        <thead>
          <tr>
            <th scope="col" class="fleet-check">
              <input type="checkbox" aria-label="Select all that are shown" checked={all?(@rows, @selection)} phx-click="all" />
            </th>
            {@heads}
          </tr>
        </thead>
        <tbody>
          <.marked :for={row <- @rows} :key={row.id} row={row} first={row.id == @first} selected={MapSet.member?(@selection.ids, row.id)} left={not Filter.shows?(@filter, row)} />
        </tbody>
      </table>
    </div>
    """
  end

  @doc """
  A vehicle's row on every page where it is not selected. Each cell is a single text, which is cheap to hand to many
  pages.
  """
  @spec line(Row.t()) :: Phoenix.LiveView.Rendered.t()
  def line(%Row{} = row) do
    cells = cells(%{row: row, __changed__: nil})
    tr(%{row: row, cells: cells, first: false, selected: false, left: false, __changed__: nil})
  end

  # The cells are the last part of the board's line.
  defp marked(%{row: row, first: false, selected: false, left: false}), do: row.line
  defp marked(%{row: row} = assigns), do: assigns |> assign(:cells, List.last(row.line.dynamic)) |> tr()

  defp tr(assigns) do
    ~H"""
    <tr
      id={"vehicle-#{@row.id}"}
      data-id={@row.id}
      class={[@row.status != :online && "fleet-old", @left && "fleet-left"]}
      title={if(@left, do: "No longer matches the filter")}
      aria-selected={if @selected, do: "true", else: "false"}
      tabindex={if @first, do: "0", else: "-1"}
    >
      <td class="fleet-check"><input type="checkbox" tabindex="-1" aria-label={"Select #{@row.id}"} checked={@selected} /></td>
      {@cells}
    </tr>
    """
  end

  defp cells(assigns) do
    ~H"""
    <th scope="row" data-label="Vehicle" class="fleet-name">{flat(name(assigns))}</th>
    <td data-label="State" class="fleet-state">{flat(state(assigns))}</td>
    <td data-label={if @row.readiness, do: "Readiness", else: "Alarms"} class="fleet-problems" title={wrong(@row)}>{flat(problems(assigns))}</td>
    <td data-label="Mode" class="fleet-mode" title={@row.mode}>{mode(@row.mode)}</td>
    <td data-label="Battery" class={["number", @row.battery && "fleet-share"]}>{flat(battery(assigns))}</td>
    <td data-label="GPS" class={gps(@row.fix)}>{fix(@row)}</td>
    <td data-label="Height" class="number">{known(@row.height)}</td>
    <td data-label="Speed" class="number">{known(@row.speed)}</td>
    <td data-label="Link" class={["number", weak(@row.link)]}>{known(@row.link)}</td>
    """
  end

  defp name(assigns) do
    ~H"""
    <div class="fleet-line">
      <.link navigate={"/vehicles/#{URI.encode(@row.id, &URI.char_unreserved?/1)}"} tabindex="-1">{@row.id}</.link>
      <.badge :if={@row.holder} kind="info" title={"In charge: #{@row.holder}"}><.icon name="lock" />{@row.holder}</.badge>
    </div>
    <div class="fleet-line muted" title={Enum.join(@row.tags, ", ")}>
      <span class="fleet-kind" title={"#{@row.kind} #{firmware(@row)}"}>
        <span class="fleet-what">{@row.kind}</span> {firmware(@row)}
      </span>
      <span :if={@row.via} class="fleet-via">via {@row.via}</span>
      <span :for={tag <- @row.tags} class="badge">{tag}</span>
    </div>
    """
  end

  defp firmware(row), do: "#{Firmware.title(row.autopilot)} #{row.firmware}"

  # What is well is plain text: a frame and a colour are for what is not.
  defp state(assigns) do
    ~H"""
    <.badge :if={kind(@row.state)} kind={kind(@row.state)}>{word(@row)}</.badge>
    <span :if={!kind(@row.state)}>{word(@row)}</span><.age us={@row.silent_us} />
    """
  end

  defp wrong(%{readiness: nil, problems: problems}), do: Enum.map_join(problems, ", ", &elem(&1, 1))
  defp wrong(%{open: open}), do: Enum.join(open, "\n")

  # Before it is armed: whether it is ready, and how much is not.
  defp problems(%{row: %{readiness: state}} = assigns) when state != nil do
    ~H"""
    <div class="fleet-worst">
      <.readiness state={@row.readiness} />
      <.badge :if={@row.open != []}>{length(@row.open)}</.badge>
    </div>
    """
  end

  # The worst one, and how many more: a row keeps its height whatever is wrong.
  defp problems(assigns) do
    ~H"""
    <div :if={@row.problems != []} class="fleet-worst">
      <.badge :for={{severity, text} <- Enum.take(@row.problems, 1)} kind={Atom.to_string(severity)}>{text}</.badge>
      <.badge :if={length(@row.problems) > 1}>+{length(@row.problems) - 1}</.badge>
    </div>
    """
  end

  # AUTO_LOITER and AUTO_LAND must not look alike: first what the vehicle does in it, then the firmware's name, which
  # goes on in the next line if it is too long.
  defp mode(nil), do: "–"

  defp mode(name) do
    parts =
      for part <- String.split(name, "_"),
          do: part |> Phoenix.HTML.html_escape() |> Phoenix.HTML.Safe.to_iodata()

    name_there = Enum.intersperse(parts, "_<wbr>")
    meaning = Firmware.meaning(name)

    cond do
      meaning == nil -> {:safe, IO.iodata_to_binary(name_there)}
      String.upcase(meaning) == name -> meaning
      true -> {:safe, IO.iodata_to_binary([meaning, " <small>", name_there, "</small>"])}
    end
  end

  # A bar only where the charge begins to matter.
  defp battery(%{row: %{battery: left}} = assigns) when left != nil and left < 0.4 do
    text = "#{round(left * 100)}"
    assigns = assign(assigns, kind: charged(left), text: text)
    ~H[<.meter value={@row.battery} label="Battery" kind={@kind} text={@text} />]
  end

  # Many vehicles report only the voltage.
  defp battery(%{row: %{battery: nil, voltage: volts}} = assigns) when is_number(volts),
    do: ~H"{@row.voltage} V"

  defp battery(assigns), do: ~H"{known(@row.battery && round(@row.battery * 100))}"

  defp flat(rendered), do: {:safe, rendered |> Phoenix.HTML.Safe.to_iodata() |> IO.iodata_to_binary()}

  attr :order, :any, required: true

  @doc "The heads of the columns."
  def heads(assigns) do
    ~H"""
    <.head order={@order} by="id" label="Vehicle" />
    <.head order={@order} by="state" label="State" />
    <.head order={@order} by="problems" label="Ready, alarms" />
    <.head order={@order} by="mode" label="Mode" />
    <.head order={@order} by="battery" label="Battery" unit="%" />
    <.head order={@order} by="gps" label="GPS" />
    <.head order={@order} by="height" label="Height" unit="m" />
    <.head order={@order} by="speed" label="Speed" unit="m/s" />
    <.head order={@order} by="link" label="Link" unit="%" />
    """
  end

  attr :order, :any, required: true
  attr :by, :string, required: true
  attr :label, :string, required: true
  attr :unit, :string, default: nil, doc: "of its numbers"

  defp head(assigns) do
    ~H"""
    <th scope="col" class={@unit && "number"} aria-sort={sorted(@order, @by)}>
      <button type="button" class="sort" phx-click="sort" phx-value-by={@by}>
        <span>{@label} <small :if={@unit}>{@unit}</small></span><.icon :if={elem(@order, 0) == @by} name={if elem(@order, 1) == :asc, do: "chevron-up", else: "chevron-down"} />
      </button>
    </th>
    """
  end

  defp sorted({by, :asc}, by), do: "ascending"
  defp sorted({by, :desc}, by), do: "descending"
  defp sorted(_order, _by), do: nil

  defp all?(rows, selection), do: Enum.all?(rows, &MapSet.member?(selection.ids, &1.id))

  defp kind(:lost), do: "bad"
  defp kind(:failsafe), do: "bad"
  defp kind(:stale), do: "warn"
  defp kind(_well), do: nil

  defp word(%{state: :armed, in_air: true}), do: "in air"
  defp word(%{armed: nil, state: :disarmed}), do: "unknown"
  defp word(%{state: state}), do: Atom.to_string(state)

  defp charged(left) when left <= 0.15, do: "bad"
  defp charged(left) when left <= 0.3, do: "warn"
  defp charged(_left), do: nil

  defp fix(%{fix: nil}), do: "–"
  defp fix(%{fix: fix}) when fix < 2, do: "none"
  defp fix(%{fix: fix, satellites: n}), do: "#{fix_name(fix)}#{if n, do: " · #{n}"}"

  defp fix_name(2), do: "2D"
  defp fix_name(3), do: "3D"
  defp fix_name(4), do: "DGPS"
  defp fix_name(5), do: "RTK ~"
  defp fix_name(6), do: "RTK"
  defp fix_name(_static_or_ppp), do: "fix"

  defp gps(fix) when is_integer(fix) and fix < 3, do: "fleet-bad"
  defp gps(_fix), do: nil

  defp weak(score) when is_integer(score) and score < 30, do: "fleet-bad"
  defp weak(_score), do: nil

  defp known(nil), do: "–"
  defp known(number), do: number
end
