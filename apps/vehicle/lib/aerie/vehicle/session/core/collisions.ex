defmodule Aerie.Vehicle.Session.Core.Collisions do
  @moduledoc """
  Two vehicles with one id: feeds `Aerie.Vehicle.Collision.Detector` with what identifies a vehicle, and acts on its
  verdict. Actions are newest first.
  """

  alias Aerie.Vehicle.{Collision, State}
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Events.Detector.Observation
  alias Aerie.Vehicle.Services.Links.Reception
  alias MavCodec.Messages, as: M

  @heartbeat M.Heartbeat.id()
  @position M.GlobalPositionInt.id()
  @autopilot_version M.AutopilotVersion.id()
  @identifying [@heartbeat, @position, @autopilot_version]
  @with_clock [M.SystemTime.id(), M.Attitude.id(), @position]
  # A vehicle that changes its address is heard by both for a moment.
  @claim_us 2_500_000
  @claim_gap_us 3_000_000
  @max_claims 16
  # No vehicle flies faster.
  @max_speed_m_s 100

  @type acc :: {Core.t(), [Core.action()]}

  @doc "Whether frames may be those of two vehicles that are not separated."
  @spec suspected?(Core.t(), integer()) :: boolean()
  def suspected?(core, at),
    do: Collision.Suspicion.two?(core.suspicion, core.collision_detector, core.owner, at)

  @doc "Position, type or unique id that a message has just brought into the state."
  @spec reading(Core.t(), [Core.action()], {id :: non_neg_integer(), struct()}, integer()) :: acc()
  def reading(core, actions, {@position, _message}, at) do
    case State.data(core.state, :position) do
      %{lat: nil} ->
        {core, actions}

      %{lat: lat, lon: lon} ->
        detected = Collision.Detector.position(core.collision_detector, {lat, lon}, at, core.path)
        verdict(core, actions, detected, :position, at)
    end
  end

  def reading(core, actions, {@heartbeat, message}, at) do
    type = {message.type, message.autopilot}
    verdict(core, actions, Collision.Detector.type(core.collision_detector, type, at, core.path), :type, at)
  end

  def reading(core, actions, {@autopilot_version, _message}, at) do
    detected = Collision.Detector.uid(core.collision_detector, core.state.uid, core.path)
    verdict(core, actions, detected, :uid, at)
  end

  def reading(core, actions, _other, _at), do: {core, actions}

  @doc "A reading of the vehicle's clock, by the id of the message that carried it."
  @spec boot_time(Core.t(), [Core.action()], id :: non_neg_integer(), non_neg_integer(), integer()) :: acc()
  def boot_time(core, actions, id, boot_ms, at) do
    detected = Collision.Detector.boot_time(core.collision_detector, id, boot_ms, at, core.path)
    verdict(core, actions, detected, {:boot_time, id}, at)
  end

  @doc """
  A frame by a path of the other vehicle: it changes no state, but it shows whether there still are two.
  """
  @spec other_vehicle(Core.t(), [Core.action()], struct()) :: acc()
  def other_vehicle(core, actions, %{id: id, at: at} = frame) when id in @identifying or id in @with_clock do
    with true <- frame.component == core.component, {:ok, message} <- MavCodec.decode(frame) do
      {core, actions} = clock_of_other(core, actions, id, message, at)
      reading_of_other(core, actions, id, message, at)
    else
      _not_identifying -> {core, actions}
    end
  end

  def other_vehicle(core, actions, _frame), do: {core, actions}

  defp clock_of_other(core, actions, id, %{time_boot_ms: boot_ms}, at),
    do: boot_time(core, actions, id, boot_ms, at)

  defp clock_of_other(core, actions, _id, _message, _at), do: {core, actions}

  # Read into an empty state: this vehicle's own must not change.
  defp reading_of_other(core, actions, id, message, at) when id in @identifying do
    case State.apply(%State{}, id, message, at) do
      {:invalid, _field} ->
        {core, actions}

      {state, _groups} ->
        {read, actions} = reading(%{core | state: state}, actions, {id, message}, at)
        {%{read | state: core.state}, actions}
    end
  end

  defp reading_of_other(core, actions, _id, _message, _at), do: {core, actions}

  @doc """
  A message with an old clock. By a late link it tells where the vehicle was; a position where it cannot have been so
  shortly before is another vehicle's. Without this check, two vehicles that were switched on within half a minute look like
  one with a late link.
  """
  @spec late_message(Core.t(), [Core.action()], struct(), struct()) :: acc()
  def late_message(core, actions, %{id: @position, at: at}, message) do
    with %{lat: lat, lon: lon} when lat != nil <- State.data(core.state, :position),
         known when is_integer(known) <- core.state.boot_ms,
         reach_m = 1000 + abs(known - message.time_boot_ms) / 1000 * @max_speed_m_s,
         there = {message.lat / 1.0e7, message.lon / 1.0e7},
         true <- Collision.Detector.distance_m({lat, lon}, there) > reach_m do
      reading_of_other(core, actions, @position, message, at)
    else
      _within_reach -> {core, actions}
    end
  end

  def late_message(core, actions, _frame, _message), do: {core, actions}

  @doc """
  Somebody sends under the vehicle's id by a path that is not its own. That is reported when it goes on, and changes
  nothing.
  """
  @spec claimed(Core.t(), [Core.action()], Collision.Owner.path(), integer()) :: acc()
  def claimed(%{other_vehicle: %{claims: claims} = other_vehicle} = core, actions, path, at) do
    claims = Map.filter(claims, fn {_path, {_since, last}} -> at - last <= @claim_gap_us end)
    {since, _last} = Map.get(claims, path, {at, at})

    claims =
      if map_size(claims) < @max_claims or is_map_key(claims, path),
        do: Map.put(claims, path, {since, at}),
        else: claims

    core = %{core | other_vehicle: %{other_vehicle | claims: claims}}
    if at - since < @claim_us, do: {core, actions}, else: report_claims(core, actions, at)
  end

  # A collision of two vehicles says more.
  defp report_claims(%{other_vehicle: %{paths: [_ | _]}} = core, actions, _at), do: {core, actions}

  defp report_claims(%{other_vehicle: other_vehicle} = core, actions, at) do
    claimants = for {path, {since, _last}} <- other_vehicle.claims, at - since >= @claim_us, do: path
    kept = Enum.map(Reception.links(core.reception), &to_string/1)
    others = claimants |> Enum.map(&MavRouter.Routes.Collisions.text/1) |> Enum.uniq() |> Enum.sort()
    collision = %{at: max(at, core.now), sign: "claim", links: [kept, others]}

    observation =
      Observation.new(:collision, collision.at, core.state.boot_ms, Map.take(collision, [:sign, :links]))

    {%{core | other_vehicle: %{other_vehicle | collision: collision}, dirty: true},
     [{:observe, observation} | actions]}
  end

  defp verdict(core, actions, {detector, :one}, _sign, _at),
    do: {%{core | collision_detector: detector}, actions}

  defp verdict(core, actions, {detector, :two}, sign, at) do
    {ones, others} = Collision.Detector.paths(detector, sign)
    {owner, kept, other} = Collision.Owner.decide(core.owner, ones, others, at)
    collision = %{at: at, sign: name(sign), links: Collision.Owner.describe(kept, other)}
    observation = Observation.new(:collision, at, core.state.boot_ms, Map.take(collision, [:sign, :links]))
    other_vehicle = %{core.other_vehicle | collision: collision}
    core = %{core | collision_detector: detector, owner: owner, other_vehicle: other_vehicle, dirty: true}
    separate({core, [{:observe, observation} | actions]}, at)
  end

  defp name({:boot_time, _id}), do: "time_boot_ms"
  defp name(sign), do: Atom.to_string(sign)

  @doc "Tells by which paths the other vehicle is heard, if that has changed."
  @spec separate(acc(), integer()) :: acc()
  def separate({%{other_vehicle: %{paths: last}} = core, actions} = acc, now) do
    case Collision.Owner.others(core.owner, now) do
      ^last ->
        acc

      paths ->
        links =
          Enum.map(paths, &Collision.Owner.link/1) -- Enum.map(core.owner.kept, &Collision.Owner.link/1)

        other_vehicle = %{core.other_vehicle | paths: paths}
        core = %{core | other_vehicle: other_vehicle, reception: Reception.without(core.reception, links)}
        {core, [{:other_vehicle, paths} | actions]}
    end
  end
end
