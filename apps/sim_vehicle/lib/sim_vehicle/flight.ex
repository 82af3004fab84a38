defmodule SimVehicle.Flight do
  @moduledoc """
  Carries out what the vehicle is doing (`vehicle.flight`, a goal of `SimVehicle.Flight.Goal` or a mission) and tells
  the personality what happened:

  - `:airborne` the vehicle left the ground, `:takeoff_done`, `:arrived`
  - `{:phase, tag}` a step of a sequence began (`:climb`, `:return`, `:wait`, `:descend`, `:land`)
  - `{:touchdown, speed}` it met the ground (m/s); `:landed` it stands for good
  - `{:item, seq}` the mission goes on to this item, `{:reached, seq}`, `:mission_done`
  """

  alias SimVehicle.Vehicle
  alias SimVehicle.Physics.{Kinematics, Wind}
  alias SimVehicle.Flight.{Goal, Mission}

  @settle_us 2_000_000
  # Below this height a vehicle counts as standing on the ground.
  @lift_off 0.15

  @doc "Moves the vehicle for `dt` seconds."
  @spec step(Vehicle.t(), float) :: Vehicle.t()
  def step(%{flight: :off, airborne: false} = v, dt), do: %{v | kin: Kinematics.step(v.kin, :off, dt)}

  def step(vehicle, dt) do
    {setpoint, v} = setpoint(vehicle, 4)
    kin = Kinematics.step(v.kin, setpoint, dt, if(v.airborne, do: Wind.velocity(v.wind), else: {0.0, 0.0}))
    %{v | kin: kin} |> lift_off() |> touch_down()
  end

  @doc "Starts doing `goal`; without motors there is nothing to do, in the air neither."
  @spec go(Vehicle.t(), Goal.t()) :: Vehicle.t()
  def go(%{armed: false} = v, _goal), do: %{v | flight: :off, mission: Mission.stop(v)}
  def go(v, goal), do: %{v | flight: goal, mission: Mission.stop(v)}

  @doc "Stops the motors, wherever the vehicle is."
  @spec disarm(Vehicle.t()) :: Vehicle.t()
  def disarm(vehicle) do
    %{vehicle | armed: false, armed_at: nil, flight: :off, mission: Mission.stop(vehicle)}
    |> Vehicle.notify(:disarmed)
  end

  @doc "Stays where it is; on the ground it stays there."
  @spec hold(Vehicle.t()) :: Vehicle.t()
  def hold(%{airborne: false} = v), do: go(v, :idle)
  def hold(v), do: go(v, Goal.hold(v.kin))

  @doc "Starts or resumes the mission."
  @spec mission(Vehicle.t()) :: Vehicle.t()
  def mission(%{armed: false} = v), do: go(v, :off)
  def mission(v), do: Mission.start(v)

  # A goal that ends hands over to the next; the limit guards against goals that end at once for ever.
  defp setpoint(v, 0), do: {Goal.standing(v), v}

  defp setpoint(%{flight: :mission} = v, left) do
    case Mission.advance(v) do
      {:cont, v, setpoint} -> {setpoint, v}
      {:again, v} -> setpoint(v, left - 1)
    end
  end

  defp setpoint(v, left) do
    case Goal.advance(v.flight, v) do
      {:cont, goal, setpoint, events} ->
        before = v.flight
        v = Enum.reduce(events, %{v | flight: goal}, &notify(&2, &1))
        if v.flight == goal or events == [], do: {setpoint, v}, else: again(v, before, left, setpoint)

      {:done, event, next} ->
        setpoint(notify(%{v | flight: next}, event), left - 1)
    end
  end

  defp again(%{flight: same} = v, same, _left, setpoint), do: {setpoint, v}
  defp again(v, _before, left, _setpoint), do: setpoint(v, left - 1)

  defp notify(v, event) do
    v = if event == :arrived, do: Vehicle.notify(v, :arrived), else: v
    v.personality.flight_event(v, event)
  end

  defp lift_off(%{airborne: false, kin: %{d: d}} = v) when d < -@lift_off do
    %{v | airborne: true} |> Vehicle.notify(:airborne) |> notify(:airborne)
  end

  defp lift_off(v), do: v

  defp touch_down(%{airborne: true, kin: %{impact: speed}} = v) when speed != nil do
    v = notify(v, {:touchdown, speed})
    if v.armed, do: %{v | flight: Goal.settle(v.now + @settle_us)}, else: landed(v)
  end

  # The ground estimate wobbles: a hover command just above the ground still counts as flying until it is touched.
  defp touch_down(%{airborne: true, flight: %{do: :settle, until: until}} = v) do
    if v.now >= until, do: landed(v), else: v
  end

  defp touch_down(%{airborne: true, flight: :off, kin: %{d: +0.0}} = v), do: landed(v)
  defp touch_down(v), do: v

  defp landed(v) do
    flight = if v.armed, do: :idle, else: :off
    %{v | airborne: false, flight: flight} |> Vehicle.notify(:landed) |> notify(:landed)
  end
end
