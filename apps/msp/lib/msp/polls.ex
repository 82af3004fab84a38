defmodule Msp.Polls do
  @moduledoc """
  How often a flight controller is asked for what (`Msp.Readings`). The message that is overdue most, measured
  in its own period, comes first, so that a slow line makes all of them rarer alike. Only the sign of life comes first
  when it is late.

  A request is made as often as the most wanted of the MAVLink messages that are made of its reply, and each of those is sent at its own rate.
  """

  alias Msp.Readings

  # By the MAVLink messages whose rate clients set: what they are made of.
  @made_of (for {name, _arguments, _every, rated} <- Readings.polls(), module <- rated, reduce: %{} do
              made_of -> Map.update(made_of, module.id(), [name], &[name | &1])
            end)
  @fastest_us 40_000
  @slowest_us 5_000_000
  @sign_us 1_000_000
  # The sign of life, in which changes of the mode show: never rarer than usual, as the height, by which it is in the
  # air or not.
  @status ["STATUS_EX", "MSP2_INAV_STATUS"]

  defstruct polls: %{}, wanted: %{}, told: %{}

  @typedoc """
  - `polls`: by message: its arguments, its period and usual period (us), when it is due; none once the vehicle has refused it
  - `wanted`: by MAVLink message: the interval (us) that clients want, `:never` for none; `told`: when it was sent last
  """
  @type t :: %__MODULE__{
          polls: %{String.t() => map},
          wanted: %{non_neg_integer => pos_integer | :never},
          told: %{non_neg_integer => integer}
        }

  @doc "The polls of a firmware, all due."
  @spec new(Msp.Modes.firmware(), integer) :: t
  def new(firmware, now) do
    polls =
      for {name, arguments, every, _rated} <- Readings.polls(),
          us = every[firmware] && every[firmware] * 1000,
          into: %{},
          do: {name, %{arguments: arguments, period: us, usual: us, due: now}}

    %__MODULE__{polls: polls}
  end

  @doc "The message that is due at `now`, or when the next one will be."
  @spec next(t, integer) :: {:ask, String.t(), map} | {:at, integer} | :none
  def next(%__MODULE__{polls: polls}, _now) when polls == %{}, do: :none

  def next(%__MODULE__{polls: polls}, now) do
    {name, poll} =
      Enum.find(polls, fn {name, poll} -> name in @status and now - poll.due > @sign_us end) ||
        Enum.max_by(polls, fn {name, poll} -> {(now - poll.due) / poll.period, name} end)

    if poll.due <= now,
      do: {:ask, name, poll.arguments},
      else: {:at, polls |> Map.values() |> Enum.map(& &1.due) |> Enum.min()}
  end

  @doc "The message that says whether the vehicle is armed, with its arguments; nil once the vehicle has refused it."
  @spec status(t) :: {String.t(), map} | nil
  def status(%__MODULE__{polls: polls}),
    do:
      Enum.find_value(@status, fn name ->
        with(%{arguments: arguments} <- polls[name], do: {name, arguments})
      end)

  @doc "Whether one has been due for longer than its own period: whatever else there is to ask has to wait for it."
  @spec late?(t, integer) :: boolean
  def late?(%__MODULE__{polls: polls}, now),
    do: Enum.any?(polls, fn {_name, poll} -> now - poll.due > poll.period end)

  @doc "It was asked: it is due again a period later."
  @spec asked(t, String.t(), integer) :: t
  def asked(polls, name, now),
    do: update(polls, name, &next_one(%{&1 | due: max(&1.due, now - &1.period) + &1.period}))

  # iNav's home, and where it is.
  defp next_one(%{arguments: %{number: number}} = poll), do: %{poll | arguments: %{number: 255 - number}}
  defp next_one(poll), do: poll

  @doc "These are to be asked at once."
  @spec soon(t, [String.t()], integer) :: t
  def soon(polls, names, now),
    do: Enum.reduce(names, polls, fn name, polls -> update(polls, name, &%{&1 | due: min(&1.due, now)}) end)

  @doc "The messages that say whether it is armed."
  @spec status_names() :: [String.t()]
  def status_names, do: @status

  @doc "Whether it is asked for this."
  @spec asks?(t, String.t()) :: boolean
  def asks?(%__MODULE__{polls: polls}, name), do: is_map_key(polls, name)

  @doc "The vehicle refused it, as a build without the part that it is about does: it is asked no more."
  @spec refused(t, String.t()) :: t
  def refused(%__MODULE__{polls: polls} = all, name), do: %{all | polls: Map.delete(polls, name)}

  defp update(%__MODULE__{polls: polls} = all, name, fun) do
    if is_map_key(polls, name), do: %{all | polls: Map.update!(polls, name, fun)}, else: all
  end

  @doc """
  The rate that clients want for a MAVLink message: the interval in us, 0 for the usual one, below 0 for none. `:error` for a message that
  is not made here.
  """
  @spec interval(t, message_id :: non_neg_integer, us :: integer) :: {:ok, t} | :error
  def interval(%__MODULE__{wanted: wanted} = polls, id, us) when is_map_key(@made_of, id) do
    wanted =
      cond do
        us == 0 -> Map.delete(wanted, id)
        us < 0 -> Map.put(wanted, id, :never)
        true -> Map.put(wanted, id, max(us, @fastest_us))
      end

    polls = %{polls | wanted: wanted}

    {:ok,
     Enum.reduce(@made_of[id], polls, fn name, polls ->
       update(polls, name, &%{&1 | period: period(name, &1.usual, wanted)})
     end)}
  end

  def interval(_polls, _id, _us), do: :error

  # As the most wanted of what is made of it.
  defp period(name, usual, wanted) do
    intervals = for {id, names} <- @made_of, name in names, do: Map.get(wanted, id, usual)
    least = intervals |> Enum.reject(&(&1 == :never)) |> Enum.min(fn -> @slowest_us end) |> min(@slowest_us)
    if name == "ALTITUDE" or name in @status, do: min(least, usual), else: least
  end

  @doc "The present interval of a MAVLink message in us, -1 for one that nobody wants, nil for one that is not made here."
  @spec interval(t, message_id :: non_neg_integer) :: pos_integer | -1 | nil
  def interval(%__MODULE__{polls: polls, wanted: wanted}, id) do
    usual = for name <- Map.get(@made_of, id, []), poll = polls[name], do: poll.usual

    case wanted do
      _any when usual == [] -> nil
      %{^id => :never} -> -1
      %{^id => us} -> us
      _usual -> Enum.max(usual)
    end
  end

  @doc "Whether a MAVLink message is to be sent, now that there is one."
  @spec tell(t, message_id :: non_neg_integer, integer) :: {boolean, t}
  def tell(%__MODULE__{told: told, wanted: wanted} = polls, id, now) do
    case interval(polls, id) do
      nil ->
        {wanted[id] != :never, polls}

      -1 ->
        {false, polls}

      # Replies come when they come: a little early is early enough.
      us ->
        due? = now - Map.get(told, id, now - us) >= div(us * 3, 4)
        {due?, if(due?, do: %{polls | told: Map.put(told, id, now)}, else: polls)}
    end
  end
end
