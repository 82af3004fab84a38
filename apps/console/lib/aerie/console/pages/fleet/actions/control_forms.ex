defmodule Aerie.Console.Pages.Fleet.Actions.ControlForms do
  @moduledoc """
  Who is in charge of the selected vehicles (`Aerie.Control.Policy.ControlLease`), and the forms to take, take over and
  release the charge of all of them.
  """
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.Board.Row

  attr :rows, :list, required: true, doc: "of the selected vehicles"
  attr :user, :map, required: true

  @doc "One line, with the forms of what the user may change."
  def charge(assigns) do
    {own, others, free} = split(assigns.rows, assigns.user.name)
    assigns = assign(assigns, own: own, others: others, free: free, value: JSON.encode!(value(assigns.rows)))

    ~H"""
    <details class={["charge", if(@others != [], do: "other", else: "free")]} id="fleet-charge" phx-mounted={JS.ignore_attributes("open")}>
      <summary><.icon name={if @others != [], do: "lock", else: "user"} /> <span>{lease_text(@own, @others, @free)}</span> <span class="charge-open">{offer(@own, @others)}</span></summary>
      <div class="charge-forms">
        <form :if={@others != [] or @free != []} id="fleet-take" class="control" phx-hook="CommandForm" phx-auto-recover="ignore" data-type="take_control" data-value={@value}>
          <.field :if={@others != []} id="fleet-take-reason" name="reason" label="Reason (the operator in charge sees it)" maxlength="200" required={true} autocomplete="off" />
          <.button type="submit" kind="primary">{if @others != [], do: "Take over", else: "Take control"}</.button>
        </form>
        <form :if={@own != []} id="fleet-release" phx-hook="CommandForm" phx-auto-recover="ignore" data-type="release_control" data-value={@value}>
          <.button type="submit">Release</.button>
        </form>
      </div>
    </details>
    """
  end

  @doc "The data of its forms: the vehicles, and who is in charge of which."
  @spec value([Row.t()]) :: %{ids: [String.t()], holders: %{String.t() => String.t()}}
  def value(rows), do: %{ids: Enum.map(rows, & &1.id), holders: holders(rows)}

  defp holders(rows),
    do: for(%{id: id, holder: holder} when holder != nil <- rows, into: %{}, do: {id, holder})

  @doc "Whether a press was made while these were in charge. Other commands do not depend on it."
  @spec meant?(event :: map(), [Row.t()]) :: boolean()
  def meant?(%{"type" => type} = event, rows) when type in ~w(take_control release_control),
    do: event["holders"] == holders(rows)

  def meant?(_event, _rows), do: true

  @doc "The vehicles that a command about the charge is for: releasing is for one's own, taking for the others."
  @spec concerned(String.t(), [Row.t()], name :: String.t()) :: [String.t()]
  def concerned("release_control", rows, name), do: for(%{holder: ^name, id: id} <- rows, do: id)

  def concerned("take_control", rows, name),
    do: for(%{holder: holder, id: id} when holder != name <- rows, do: id)

  def concerned(_other, rows, _name), do: Enum.map(rows, & &1.id)

  defp split(rows, name) do
    {own, rest} = Enum.split_with(rows, &(&1.holder == name))
    {free, others} = Enum.split_with(rest, &(&1.holder == nil))
    {own, others, free}
  end

  # A summary has no other sign that it opens.
  defp offer(_own, [_ | _]), do: "Take over"
  defp offer([], []), do: "Take control"
  defp offer(_own, []), do: "Change"

  defp lease_text([], [], _free), do: "Control: free"
  defp lease_text(_own, [], []), do: "Control: you"

  defp lease_text(own, others, free) do
    held =
      for {holder, rows} <- Enum.group_by(others, & &1.holder), do: "#{holder} controls #{vehicles(rows)}"

    yours = if own != [], do: ["you control #{vehicles(own)}"], else: []
    nobody = if free != [], do: ["free: #{vehicles(free)}"], else: []
    Enum.join(held ++ yours ++ nobody, ", ")
  end

  defp vehicles(rows) when length(rows) <= 3, do: Enum.map_join(rows, ", ", & &1.id)
  defp vehicles(rows), do: "#{length(rows)} vehicles"
end
