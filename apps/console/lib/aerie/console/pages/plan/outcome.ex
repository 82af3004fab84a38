defmodule Aerie.Console.Pages.Plan.Outcome do
  @moduledoc "The progress and the results of a transfer on the plan page."
  use Aerie.Console, :component

  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Pages.Plan.Transfer

  attr :transfer, :map, required: true
  attr :vehicle, :string, required: true
  attr :user, :map, required: true

  @doc "The progress of a transfer, the result of each part, and the button that removes what was looked at."
  def outcome(assigns) do
    ~H"""
    <section id="plan-transfer" class="card plan-transfer" aria-label="Transfer">
      <header class="spread">
        <h2>{title(@transfer, Transfer.over?(@transfer))}</h2>
        <.button :if={Transfer.over?(@transfer)} kind="quiet" icon="x" label="Close" phx-click="close_transfer" />
      </header>
      <ul aria-live="polite">
        <li :for={{kind, {outcome, text}} <- @transfer.results} :key={kind}>
          <.badge kind={badge_kind(outcome)}>{Transfer.label(kind)}</.badge> {text}
        </li>
      </ul>
      <p :if={@transfer.kind}>
        <.badge kind="info">{Transfer.label(@transfer.kind)}</.badge> <.meter value={Transfer.share(@transfer)} label="Progress" text={phase(@transfer.progress)} />
      </p>
      <.hold_button
        :if={@transfer.aboard && @transfer.vehicle == @vehicle && Roles.at_least?(@user.role, :operator)}
        id="plan-remove"
        event="remove_aboard"
        icon="trash"
        kind="danger"
        phx-value-digest={@transfer.aboard.digest}
        phx-value-vehicle={@vehicle}
        disabled={not may_remove?(@transfer.aboard, @user)}
        reason="Removing a fence needs the permission protection or pilot"
      >Remove the {name(@transfer.aboard.kind)} aboard {@vehicle}: {@transfer.aboard.text}</.hold_button>
    </section>
    """
  end

  defp may_remove?(%{kind: kind}, user),
    do: kind != :fence or Enum.any?([:protection, :pilot], &Roles.allowed?(user, &1))

  defp badge_kind(:ok), do: "ok"
  defp badge_kind(:none), do: "plain"
  defp badge_kind(:error), do: "bad"

  defp title(%{what: what, vehicle: vehicle}, over?) do
    {now, done} =
      case what do
        :upload -> {"Sending to", "Sent to"}
        :download -> {"Reading from", "Read from"}
        :verify -> {"Comparing with", "Compared with"}
        {:look, _kind} -> {"Reading from", "On board"}
        {:remove, _aboard} -> {"Removing from", "Removed from"}
      end

    "#{if over?, do: done, else: now} #{vehicle}"
  end

  defp name(:mission), do: "mission"
  defp name(:fence), do: "fence"
  defp name(:rally), do: "rally points"

  # The vehicle's home counts as an item while a mission is transferred, so per cent say it better.
  defp phase(%{"phase" => phase, "done" => done, "total" => total})
       when is_integer(total) and is_integer(done) and total > 0,
       do: "#{phase}, #{min(100, div(100 * done, total))} %"

  defp phase(%{"phase" => phase}) when is_binary(phase), do: phase
  defp phase(_nothing), do: "waiting"
end
