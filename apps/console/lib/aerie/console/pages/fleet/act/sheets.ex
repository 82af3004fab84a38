defmodule Aerie.Console.Pages.Fleet.Act.Sheets do
  @moduledoc "The sheets by their names, each with its dialog."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.Act.Mission.{Start, StartSheet}
  alias Aerie.Console.Pages.Fleet.Act.{Return, ReturnSheet, TakeOff, TakeOffSheet}

  @modules %{"take_off" => TakeOff, "return" => Return, "start" => Start}

  @doc "The names."
  @spec names() :: [String.t()]
  def names, do: Map.keys(@modules)

  @doc "The module of a sheet (`Aerie.Console.Pages.Fleet.Act.Sheet`)."
  @spec module(name :: String.t()) :: module()
  def module(name), do: Map.fetch!(@modules, name)

  attr :sheet, :any, required: true
  attr :facts, :map, required: true
  attr :error, :string, default: nil

  @doc "The dialog of the sheet that is open; nothing without one."
  def dialog_of(%{sheet: nil} = assigns), do: ~H""
  def dialog_of(%{sheet: %TakeOff{}} = assigns), do: TakeOffSheet.sheet(assigns)
  def dialog_of(%{sheet: %Return{}} = assigns), do: ReturnSheet.return_sheet(assigns)
  def dialog_of(%{sheet: %Start{}} = assigns), do: StartSheet.start_sheet(assigns)
end
