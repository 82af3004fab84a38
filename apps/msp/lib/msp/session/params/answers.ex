defmodule Msp.Session.Params.Answers do
  @moduledoc "The answers about a parameter for a client: PARAM_VALUE, PARAM_ERROR, and texts."

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.ShortName
  alias Msp.Session
  alias Msp.Session.{Output, Tasks}
  alias Protocols.Params.Listing

  # MAV_PARAM_TYPE: INT32, UINT32, REAL32
  @types %{integer: 6, unsigned: 5, float: 9}
  # MAV_PARAM_ERROR
  @errors %{unknown: 1, out_of_range: 2, denied: 3, mismatch: 7}
  @notice 5

  @type type :: :integer | :unsigned | :float
  @type error :: :unknown | :out_of_range | :denied | :mismatch

  @doc """
  The type of a parameter, by that of the flight controller and its highest value. As with PX4 all integers have 32
  bits, because MAVSDK lists no unsigned ones (P2); those that may be too large for that are unsigned.
  """
  @spec type(:u8 | :i8 | :u16 | :i16 | :u32 | :f32, high :: number | nil) :: type
  def type(:f32, _high), do: :float
  def type(:u32, high) when high == nil or high > 0x7FFFFFFF, do: :unsigned
  def type(_integer, _high), do: :integer

  @doc "The value of the task's parameter, which ends it."
  @spec report(Session.t(), Tasks.task(), number, type) :: Session.t()
  def report(session, task, value, type) do
    listing = session.params.listing || Listing.new([], :bytewise)
    session |> Tasks.done(task) |> Output.emit(value(listing, task.name, value, type))
  end

  @doc "A parameter of a list."
  @spec value(Listing.t(), String.t(), number, type) :: struct
  def value(listing, name, value, type),
    do: %{Listing.value(listing, name, value, @types[type]) | param_id: ShortName.of(name)}

  @doc "The task cannot be done."
  @spec refuse(Session.t(), Tasks.task(), error, String.t()) :: Session.t()
  def refuse(session, task, code, why) do
    session
    |> Tasks.done(task)
    |> error(task.name, nil, code, task.from)
    |> Output.text(@notice, "#{task.name}: #{why}")
  end

  @doc "A request cannot be done, of a parameter by its name or by its index in the list."
  @spec error(Session.t(), String.t(), non_neg_integer | nil, error, {byte, byte}) :: Session.t()
  def error(session, name, index, code, {system, component}) do
    Output.emit(session, %M.ParamError{
      target_system: system,
      target_component: component,
      param_id: ShortName.of(name),
      param_index: index || -1,
      error: @errors[code]
    })
  end

  @doc "A parameter was changed: said once until the next restart or the next storing."
  @spec changed(Session.t()) :: Session.t()
  def changed(%{params: %{unsaved: true}} = session), do: session

  def changed(session) do
    text = "Settings changed, not stored yet: the next restart forgets them"
    put_in(session.params.unsaved, true) |> Output.text(@notice, text)
  end
end
