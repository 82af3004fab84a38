defmodule Aerie.Console.UI.Table do
  @moduledoc "Tables. On a phone each row becomes a card with labelled cells."
  use Phoenix.Component

  import Aerie.Console.UI.Icon

  attr :id, :string, required: true
  attr :rows, :list, required: true
  attr :row_id, :any, required: true, doc: "a function of a row: its id in the page"
  attr :row_class, :any, default: nil, doc: "a function of a row"
  attr :label, :string, required: true, doc: "what the table lists, for screen readers"
  attr :sort, :any, default: nil, doc: "`{column, :asc | :desc}`"
  attr :sort_event, :string, default: "sort"
  attr :class, :string, default: nil

  slot :col, required: true do
    attr :label, :string, required: true
    attr :sort, :string
    attr :number, :boolean
    attr :class, :string
  end

  @doc """
  A table. A column with `sort` has a button in its header that sends `sort_event` with this value as `"by"`; `number` aligns its cells to the
  right.
  """
  def data_table(assigns) do
    ~H"""
    <%!-- A box that scrolls has to be reached by the keyboard. --%>
    <div class={["table-box", @class]} tabindex="0" role="group" aria-label={@label}>
      <table id={@id} class="table">
        <caption class="visually-hidden">{@label}</caption>
        <thead>
          <tr>
            <th :for={col <- @col} scope="col" class={[col[:number] && "number", col[:class]]} aria-sort={sorted(@sort, col)}>
              <button :if={col[:sort]} type="button" class="sort" phx-click={@sort_event} phx-value-by={col[:sort]}>
                {col.label}<.icon :if={direction(@sort, col)} name={direction(@sort, col)} />
              </button>
              <span
                :if={!col[:sort]} class={col.label == "" && "visually-hidden"}
              >{if col.label == "", do: "Actions", else: col.label}</span>
            </th>
          </tr>
        </thead>
        <tbody>
          <tr :for={row <- @rows} :key={@row_id.(row)} id={@row_id.(row)} class={@row_class && @row_class.(row)}>
            <td :for={col <- @col} data-label={col.label} class={[col[:number] && "number", col[:class]]}>{render_slot(col, row)}</td>
          </tr>
        </tbody>
      </table>
    </div>
    """
  end

  defp sorted({column, :asc}, %{sort: column}), do: "ascending"
  defp sorted({column, :desc}, %{sort: column}), do: "descending"
  defp sorted(_sort, _col), do: nil

  defp direction({column, :asc}, %{sort: column}), do: "chevron-up"
  defp direction({column, :desc}, %{sort: column}), do: "chevron-down"
  defp direction(_sort, _col), do: nil
end
