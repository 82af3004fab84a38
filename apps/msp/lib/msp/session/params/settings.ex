defmodule Msp.Session.Params.Settings do
  @moduledoc "One setting of iNav, by name: what it is comes with its value. To set it, the value is written, and read again."
  @behaviour Msp.Session.Params

  alias Msp.Params.Setting
  alias Msp.Session.Params
  alias Msp.Session.Params.Answers

  @doc "The first request."
  @spec first(String.t()) :: map
  def first(name), do: %{by: __MODULE__, ask: info(name), stage: :before}

  @doc "The request for a setting by its name or its number."
  @spec info(String.t() | non_neg_integer) :: {String.t(), map}
  def info(name), do: {"MSP2_COMMON_SETTING_INFO", %{name_or_index: Setting.request(name)}}

  @doc "The type by which clients get it."
  @spec told(Setting.t()) :: Answers.type()
  def told(setting), do: Answers.type(setting.type, setting.high)

  @impl Params
  def again(task), do: info(task.name)

  @impl Params
  def read(_task, values) do
    case Setting.read(values) do
      {:ok, setting} -> {:ok, setting, setting.value, told(setting)}
      _text -> {:error, "it is text, which MAVLink's parameters cannot be"}
    end
  end

  @impl Params
  def write(task, setting) do
    with {:ok, payload} <- Setting.write(setting, task.value),
         do: {:ok, {"MSP2_COMMON_SET_SETTING", %{setting: payload}}, nil}
  end
end
