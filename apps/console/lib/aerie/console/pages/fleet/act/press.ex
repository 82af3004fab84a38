defmodule Aerie.Console.Pages.Fleet.Act.Press do
  @moduledoc """
  The operation that a press asks for. Pure. The press has made its id in the browser, and it is the operation's: a
  press that arrives twice begins one.
  """

  alias Aerie.Console.Commands.{Form, Submit}
  alias Aerie.Vehicle.Command

  # Their names on the page.
  @types %{
    "hold" => "Hold",
    "rtl" => "Return",
    "land" => "Land",
    "take_control" => "Take control",
    "release_control" => "Release"
  }
  # What ends a danger waits for nothing.
  @at_once 100

  @doc "The request that commands these vehicles, or why there is none."
  @spec request(event :: map(), [String.t()]) :: {:ok, map()} | {:error, String.t()}
  def request(%{"id" => id, "type" => type} = event, [_ | _] = vehicles) when is_map_key(@types, type) do
    fields = if is_map(event["fields"]), do: event["fields"], else: %{}

    with :ok <- id(id), {:ok, params} <- Form.read(Command.type(type), fields) do
      {:ok,
       %{
         "id" => id,
         "name" => @types[type],
         "vehicles" => vehicles,
         "command" => %{"type" => type, "params" => params},
         "step" => @at_once
       }}
    else
      {:error, <<_::binary>> = text} -> {:error, text}
      {:error, errors} -> {:error, Submit.text(errors)}
    end
  end

  def request(%{"type" => type}, []) when is_map_key(@types, type),
    do: {:error, "no vehicle is concerned"}

  def request(_event, _vehicles), do: {:error, "the page has no such action"}

  @doc "The request of one command for each vehicle, all at once; what one of them refuses keeps no other from it."
  @spec each(id :: term(), name :: String.t(), type :: String.t(), [{String.t(), params :: map()}]) ::
          {:ok, map()} | {:error, String.t()}
  def each(id, name, type, vehicles) do
    with :ok <- id(id) do
      {:ok,
       %{
         "id" => id,
         "name" => name,
         "step" => @at_once,
         "halt_ratio" => 1,
         "sequence" =>
           for(
             {vehicle, params} <- vehicles,
             do: %{"vehicle" => vehicle, "steps" => [%{"type" => type, "params" => params}]}
           )
       }}
    end
  end

  @doc "Whether a browser's id of a press can be that of an operation."
  @spec id(term()) :: :ok | {:error, String.t()}
  def id(<<id::binary>>) when byte_size(id) <= 32 do
    if Command.token?(id), do: :ok, else: id(nil)
  end

  def id(_other), do: {:error, "the press has no usable id; reload the page"}
end
