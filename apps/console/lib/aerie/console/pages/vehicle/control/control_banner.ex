defmodule Aerie.Console.Pages.Vehicle.Control.ControlBanner do
  @moduledoc "Shows who is in charge of a vehicle (`Aerie.Control.Policy.control_lease/2`), with forms to take, take over, hand over and release it."
  use Aerie.Console, :component

  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Control.Actions

  attr :view, View, required: true
  attr :user, :map, required: true
  attr :lease, :any, required: true, doc: "`t:Aerie.Control.Policy.ControlLease.t/0`, nil for nobody"

  @doc "One line, with the form of what the user may change."
  def charge(assigns) do
    assigns =
      assign(assigns,
        able: Actions.able?("take_control", assigns),
        relation: relation(assigns.lease, assigns.user),
        value: JSON.encode!(%{holder: holder(assigns.lease)})
      )

    ~H"""
    <details class={["charge", Atom.to_string(@relation)]} id="charge" phx-mounted={JS.ignore_attributes("open")}>
      <summary>
        <.icon name={if @relation == :other, do: "lock", else: "user"} />
        <span>{lease_text(@relation, @lease)}</span>
        <span :if={@lease != nil and @lease.reason != nil} class="muted">({@lease.reason})</span>
        <span :if={@able} class="charge-open">{offer(@relation)}</span>
      </summary>
      <div :if={@able} class="charge-forms">
        <form :if={@relation != :own} id="charge-take" class="control" phx-hook="CommandForm" phx-auto-recover="ignore" data-type="take_control" data-value={@value}>
          <.field
            :if={@relation == :other} id="charge-reason" name="reason" maxlength="200" required={true}
            label="Reason (the operator in charge sees it)" autocomplete="off"
          />
          <.button type="submit" kind="primary">{if @relation == :other, do: "Take over", else: "Take control"}</.button>
        </form>
        <form :if={@relation == :own} id="charge-offer" class="control" phx-hook="CommandForm" phx-auto-recover="ignore" data-type="hand_over_control" data-value={@value}>
          <.field id="charge-to" name="to" label="Hand over to (blank: anyone)" maxlength="64" autocomplete="off" />
          <.button type="submit">Hand over</.button>
        </form>
        <form :if={@relation == :own or (@relation == :other and @user.role == :admin)} id="charge-release" phx-hook="CommandForm" phx-auto-recover="ignore" data-type="release_control" data-value={@value}>
          <.button type="submit">Release</.button>
        </form>
      </div>
      <p class="hint">Anyone with the right can still hold, return or land it.</p>
    </details>
    """
  end

  @doc "Whether a press was made while this one was in charge. Other commands do not depend on it."
  @spec meant?(event :: map(), map() | nil) :: boolean()
  def meant?(%{"type" => type} = event, lease)
      when type in ~w(take_control hand_over_control release_control),
      do: event["holder"] == holder(lease)

  def meant?(_event, _lease), do: true

  defp holder(nil), do: nil
  defp holder(lease), do: lease.holder

  # A summary has no other sign that it opens.
  defp offer(:own), do: "Hand over or release"
  defp offer(:other), do: "Take over"
  defp offer(_free), do: "Take control"

  defp relation(nil, _user), do: :free
  defp relation(%{holder: name}, %{name: name}), do: :own
  defp relation(%{offered_to: to}, %{name: name}) when to == :anyone or to == name, do: :offered
  defp relation(_lease, _user), do: :other

  defp lease_text(:free, _lease), do: "Control: free"

  defp lease_text(:own, %{offered_to: nil} = lease),
    do: "Control: you, since #{Clock.minute(lease.since)}"

  defp lease_text(:own, lease), do: "Control: you, offered to #{to(lease)}"
  defp lease_text(:offered, lease), do: "Control: #{lease.holder}, offered to you"
  defp lease_text(:other, lease), do: "Control: #{lease.holder}, since #{Clock.minute(lease.since)}"

  defp to(%{offered_to: :anyone}), do: "anyone"
  defp to(%{offered_to: name}), do: name
end
