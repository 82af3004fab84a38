defmodule SimVehicle.Physics.Wind do
  @moduledoc """
  Seeded gusts: a slowly wandering disturbance north and east in m/s. The same seed gives the same gusts.
  """

  defstruct n: 0.0, e: 0.0, strength: 0.0, rand: nil

  @type t :: %__MODULE__{}

  @correlation 3.0

  @doc "Gusts with a standard deviation of `strength` m/s (0 = calm), drawn from `seed`."
  @spec new(number, integer) :: t
  def new(strength, seed), do: %__MODULE__{strength: strength * 1.0, rand: :rand.seed_s(:exsss, seed)}

  @doc "The gusts `dt` seconds later."
  @spec step(t, float) :: t
  def step(%{strength: calm} = wind, _dt) when calm == 0.0, do: wind

  def step(wind, dt) do
    {x, rand} = :rand.normal_s(wind.rand)
    {y, rand} = :rand.normal_s(rand)
    keep = :math.exp(-dt / @correlation)
    kick = wind.strength * :math.sqrt(1 - keep * keep)
    %{wind | n: wind.n * keep + kick * x, e: wind.e * keep + kick * y, rand: rand}
  end

  @doc "The disturbance now."
  @spec velocity(t) :: {float, float}
  def velocity(wind), do: {wind.n, wind.e}
end
