defmodule Aerie.Console.Pages.Plan.Check do
  @moduledoc """
  Checks a plan while it is drawn: by itself, against its own fence (`Aerie.Control.Missions.own_fence/2`), and against the policy for a vehicle.
  """

  alias Protocols.Mission.Plan
  alias Aerie.Base.Names
  alias Aerie.Control.Missions
  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Pages.Plan.Profile
  alias MavCodec.Enums.MavCmd

  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @takeoff Enum.map([:MAV_CMD_NAV_TAKEOFF, :MAV_CMD_NAV_VTOL_TAKEOFF], &MavCmd.value/1)
  @long_leg 20_000.0

  @typedoc """
  `index` of the item in the plan; nil for the plan as a whole. A plan with a `:bad` finding cannot be sent; one that is
  `outside?` of a fence only after somebody has agreed to it.
  """
  @type problem :: %{
          required(:kind) => :bad | :warn,
          required(:part) => :mission | :fence | :rally,
          required(:index) => non_neg_integer() | nil,
          required(:text) => String.t(),
          optional(:outside?) => boolean()
        }

  @doc "Whether somebody has to agree that the plan leaves a fence."
  @spec outside?([problem()]) :: boolean()
  def outside?(problems), do: Enum.any?(problems, &(&1[:outside?] == true))

  @doc "Checks the plan by itself."
  @spec alone(Plan.t()) :: [problem()]
  def alone(%Plan{items: items} = plan) do
    numbered = Enum.with_index(items)

    jumps =
      for {%{command: @jump, params: {to, _, _, _}}, index} <- numbered,
          not jump?(to, length(items)),
          do: bad(index, "item #{index + 1} jumps to an item that does not exist")

    takeoff =
      case Enum.find_index(items, &(&1.command in @takeoff)) do
        n when is_integer(n) and n > 0 -> [warn(n, "item #{n + 1}: the takeoff is not the first item")]
        _first_or_none -> []
      end

    jumps ++ takeoff ++ heights(plan) ++ legs(plan)
  end

  defp jump?(to, count), do: is_number(to) and to >= 1 and to <= count

  defp heights(plan) do
    for %{height: height, ground?: false, index: index} when height != nil and height < 0 <-
          Profile.points(plan),
        do: warn(index, "item #{index + 1} is below home")
  end

  defp legs(plan) do
    points = Profile.points(plan)

    for {from, to} <- Enum.zip(points, Enum.drop(points, 1)),
        to.metres - from.metres > @long_leg,
        do:
          warn(
            to.index,
            "item #{to.index + 1} is #{round((to.metres - from.metres) / 1000)} km from the one before it"
          )
  end

  @doc """
  Checks the plan against its own fence, and the fence, if it is sent, against the vehicle of a snapshot; nil for none.
  A plan without a fence is checked against that of `read`, the plan that was read from the vehicle, because it stays.
  """
  @spec own(Plan.t(), map() | nil, fence_sent? :: boolean(), read :: Plan.t() | nil) :: [problem()]
  def own(plan, snapshot, fence_sent?, read \\ nil)

  def own(%{fence: []} = plan, snapshot, _sent?, %{fence: [_ | _]} = read) do
    for %{outside?: true} = found <- own(%{plan | fence: read.fence}, snapshot, false),
        do: %{found | text: String.replace(found.text, "the plan's", "the vehicle's")}
  end

  def own(plan, snapshot, fence_sent?, _read) do
    for found <- Missions.own_fence(plan, snapshot),
        do:
          Map.put(
            Map.delete(found, :breach?),
            :kind,
            if(found.breach? and fence_sent?, do: :bad, else: :warn)
          )
  end

  @doc "Asks the policy about sending parts of the plan to the vehicle of a snapshot."
  @spec policy(Names.gateway(), Plan.t(), [Missions.kind()], map(), Roles.source()) :: [problem()]
  def policy(gateway, plan, parts, snapshot, user) do
    lacking = for part <- parts, reason = Missions.gap(snapshot, part), do: %{bad(nil, reason) | part: part}
    if lacking == [], do: reviewed(Missions.refused(gateway, plan, parts, snapshot, user)), else: lacking
  end

  defp reviewed({:ok, denied}),
    do: for({part, index, reason} <- denied, do: %{bad(index, reason) | part: part})

  defp reviewed({:error, reason}), do: [bad(nil, reason)]

  @doc "What keeps a draft from being sent: a zone that is still being drawn."
  @spec unfinished([term()]) :: [problem()]
  def unfinished([]), do: []
  def unfinished(_corners), do: [%{bad(nil, "a zone is not closed yet") | part: :fence}]

  defp bad(index, text), do: %{kind: :bad, part: :mission, index: index, text: text}
  defp warn(index, text), do: %{bad(index, text) | kind: :warn}
end
