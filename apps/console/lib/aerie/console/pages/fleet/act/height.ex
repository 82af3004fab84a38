defmodule Aerie.Console.Pages.Fleet.Act.Height do
  @moduledoc """
  Another height for the selected vehicles in the air: all by as many metres, so that those that fly above each other
  stay apart. Pure but for the component.
  """
  use Aerie.Console, :component

  alias Aerie.Base.Json
  alias Aerie.Console.Pages.Fleet.Act.Press
  alias Aerie.Console.Pages.Fleet.Board.Row

  @most_m 100
  @least_m 2

  @doc "The request of a press for these rows, or why there is none. `height` gives a vehicle's metres above home."
  @spec request(event :: map(), [Row.t()], (String.t() -> number() | nil)) ::
          {:ok, map()} | {:error, String.t()}
  def request(%{"air" => [_ | _] = shown} = event, rows, height) do
    flying = for %{id: id, in_air: true} <- rows, id in shown, do: id

    if Enum.sort(flying) == Enum.sort(shown) do
      with {:ok, metres} <- metres(event["fields"]),
           {:ok, targets} <- targets(flying, metres, height),
           do: Press.each(event["id"], "#{change(metres)} m", "set_altitude", targets)
    else
      {:error, "not all of them are in the air any more"}
    end
  end

  def request(_event, _rows, _height), do: {:error, "none of them is in the air"}

  defp metres(%{"metres" => <<text::binary>>}) do
    case Float.parse(text) do
      {metres, ""} when abs(metres) <= @most_m and metres != 0 -> {:ok, Float.round(metres, 1)}
      _other -> {:error, "give metres from -#{@most_m} to #{@most_m}, such as 5 or -3"}
    end
  end

  defp metres(_other), do: metres(%{"metres" => ""})

  defp targets(ids, metres, height) do
    Enum.reduce_while(ids, {:ok, []}, fn id, {:ok, targets} ->
      case height.(id) do
        present when is_number(present) and present + metres >= @least_m ->
          {:cont, {:ok, targets ++ [{id, %{"altitude" => Float.round(present + metres, 1)}}]}}

        present when is_number(present) ->
          {:halt, {:error, "#{id} would fly at #{Float.round(present + metres, 1)} m: land it instead"}}

        _unknown ->
          {:halt, {:error, "the height of #{id} is not known"}}
      end
    end)
  end

  defp change(metres), do: "Height #{if metres > 0, do: "+"}#{Json.number(metres)}"

  attr :value, :map, required: true, doc: "the ids of all that are selected"
  attr :air, :list, required: true, doc: "the ids of those in the air"

  @doc "The form."
  def height(assigns) do
    ~H"""
    <details class="charge" id="fleet-height" phx-mounted={JS.ignore_attributes("open")}>
      <summary><.icon name="altitude" /> <span>Height …</span></summary>
      <div class="charge-forms">
        <form id="fleet-height-form" class="control" phx-hook="CommandForm" phx-auto-recover="ignore">
          <.field
            id="fleet-height-metres"
            type="number"
            name="metres"
            label="Higher by (below 0: lower)"
            unit="m"
            step="any"
            autocomplete="off"
          />
          <.hold_button id="fleet-height-go" event="height" icon="altitude" value={Map.put(@value, :air, @air)}>
            Change {length(@air)} by this
          </.hold_button>
        </form>
      </div>
    </details>
    """
  end
end
