defmodule SimVehicle.Msp.Flight do
  @moduledoc "A simple copter: its sticks tilt and turn it, a throttle above the middle lifts it. A value; time comes in steps."

  @metre 111_320.0
  @hover 1500
  @full_mah 1500

  defstruct lat: 47.397742,
            lon: 8.545594,
            ground: 488.0,
            alt: 0.0,
            climb: 0.0,
            roll: 0.0,
            pitch: 0.0,
            yaw: 0.0,
            speed: 0.0,
            course: 0.0,
            drawn: 0.0,
            flown: 0.0

  @type t :: %__MODULE__{}

  @doc "Lets `dt` seconds pass. `sticks`: roll, pitch, throttle, yaw in µs; `landing`: it comes down by itself."
  @spec step(t, [integer], armed :: boolean, landing :: boolean, float) :: t
  def step(flight, [roll, pitch, throttle, yaw | _], armed?, landing?, dt) do
    climb =
      cond do
        not armed? -> if(flight.alt > 0, do: -6.0, else: 0.0)
        landing? -> -1.5
        true -> (throttle - @hover) / 500 * 5
      end

    alt = max(flight.alt + climb * dt, 0.0)
    flying? = alt > 0.05
    tilt = fn us -> if(flying?, do: (us - 1500) / 500 * 30, else: 0.0) end
    turned = flight.yaw + if(flying?, do: (yaw - 1500) / 500 * 90 * dt, else: 0.0)
    # The stick forward lowers the nose.
    {roll, pitch} = {tilt.(roll), -tilt.(pitch)}
    speed = -pitch / 3
    {north, east} = {speed * :math.cos(turned / 57.29578), speed * :math.sin(turned / 57.29578)}

    %{
      flight
      | alt: alt,
        climb: if(alt > 0, do: climb, else: 0.0),
        roll: roll,
        pitch: pitch,
        yaw: :math.fmod(turned + 720, 360),
        speed: abs(speed),
        course: :math.fmod(turned + if(speed < 0, do: 900, else: 720), 360),
        lat: flight.lat + north * dt / @metre,
        lon: flight.lon + east * dt / (@metre * :math.cos(flight.lat / 57.29578)),
        drawn: flight.drawn + if(armed?, do: 12.0, else: 0.4) * dt / 3.6,
        flown: flight.flown + if(flying?, do: dt, else: 0.0)
    }
  end

  @doc "What is left of the battery, 0..1; its voltage with four cells."
  @spec battery(t) :: {float, float}
  def battery(flight) do
    left = max(1 - flight.drawn / @full_mah, 0.0)
    {left, 4 * (3.3 + 0.9 * left)}
  end

  @doc "The capacity of its battery in mAh."
  @spec capacity() :: pos_integer
  def capacity, do: @full_mah
end
