defmodule Aerie.Control.Commands.Pipeline.Request do
  @moduledoc "A command and who gives it, as it goes through `Aerie.Control.Commands.Pipeline`."

  alias Aerie.Vehicle.Command
  alias Aerie.Control.Commands.Change
  alias Aerie.Control.Policy.{Intent, Roles}

  @enforce_keys [:command, :source, :via]
  defstruct [:command, :source, :via, :says, :progress, :change, wait?: true]

  @typedoc """
    * `:source` - the authenticated sender; the command's source is its name
    * `:via` - `"nats"`, `"rest"` or `"elixir"`; `:says` - the source that the envelope names
    * `:progress` - a process to notify of progress, and a term for the message
    * `:change` - the change to make, if it is not a command of the table
    * `:wait?` - whether the caller wants the result, or only to know that the command is under way
  """
  @type t :: %__MODULE__{
          command: Command.t(),
          source: Roles.source(),
          via: String.t(),
          says: String.t() | nil,
          progress: {pid(), term()} | nil,
          change: Change.t() | nil,
          wait?: boolean()
        }

  @doc "The intent by which the rules judge it."
  @spec intent(t()) :: Intent.t()
  def intent(%{change: nil, command: command}), do: Intent.of(command)
  def intent(%{change: change}), do: change.facts

  @doc "Whether it may be sent twice: a value, a plan or a file may."
  @spec retry(t()) :: :safe | :never
  def retry(%{change: nil, command: command}), do: Command.type(command).retry
  def retry(_change), do: :safe
end
