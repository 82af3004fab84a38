defmodule Aerie.Vehicle.Command.Refusal.Unknown do
  @moduledoc """
  What is not known, or cannot be judged or cancelled (`Aerie.Vehicle.Command.Refusal`): parts of other texts, and those
  about plans that clients write, which are refused by the rule that cannot judge them.
  """

  @reads "the gateway reads it now: try again"

  @texts [
    position: "the vehicle's position is not known",
    position_old: "the vehicle's last position is %{seconds} s old",
    heading: "the vehicle's heading is not known",
    home: "the vehicle's home is not known",
    own_height: "the vehicle's height is not known",
    home_height: "the height of its home is not known",
    above_ground: "it is given above the ground",
    anywhere: "where it leads, nobody can tell",
    nowhere: "%{lat}, %{lon} is not a place on earth",
    too_far: "where it leads is too far to be judged",
    holder_not_known: "it is not known yet which gateway holds the vehicle",
    holder_without_nats:
      "NATS is away or has no room for the buckets, so another gateway may hold the vehicle " <>
        "(shadow.without_nats: act, for the only gateway that hears it)",
    not_heard_here: "this gateway does not hear the vehicle, so it does not hold it",
    lease_asked_for: "the lease of the vehicle is being asked for",
    lease_due: "its lease has to be renewed",
    lease_ended: "the lease was not renewed before it ended",
    no_command: "no command with the id %{id} is being carried out",
    no_such_command: "no command with this id is being carried out",
    no_transfer: "no transfer with the id %{id} is under way",
    not_cancellable: "it cannot be cancelled",
    refused_again: "a repetition was refused (%{why})",
    was_accepted: "the vehicle accepted it",
    keeps_value: "it keeps %{value}",
    keeps_of_many: "the vehicle keeps %{value}",
    no_mission: "its gateway reported no mission",
    keeps_none: "it keeps no number",
    setpoints_none: "none come",
    setpoints_since: "they have come for %{ms} ms",
    mission_aboard_unknown:
      "a fence or a limit of height applies to %{command}, and the mission aboard is not known; " <>
        @reads <> " in a moment",
    fence_unknown:
      "fence_upload needs the permission protection while the fence aboard is not known; " <> @reads,
    flown_unknown:
      "the vehicle flies its mission, and the one aboard is not known; " <>
        @reads <> ", or hold the vehicle first",
    items_beside_unknown:
      "the items aboard beside it are not known; the gateway reads them now: try again, or send the plan whole",
    not_a_part: "it is not a part of the plan aboard; send the plan whole",
    plan_long: "a plan of %{n} items; at most %{most} are taken",
    uploads_begun: "too many uploads were begun and not finished; begin again in %{seconds} s",
    item_beyond: "mission item %{seq} is beyond the end of the plan",
    item_not_due: "mission item %{seq} is not due; the partial write goes on with item %{next}",
    item_differs: "mission item %{seq} came before with another content; begin the upload again",
    item_awaited:
      "the vehicle may still wait for the rest of an upload with another item %{seq}; begin again in %{seconds} s"
  ]

  @doc "The texts."
  @spec texts() :: keyword(String.t())
  def texts, do: @texts
end
