defmodule SimVehicle.Signing do
  @moduledoc """
  Signed links as ArduPilot has them: it takes SETUP_SIGNING from whoever may speak to it, unless it is armed, from then on
  signs everything and asks for signatures, RADIO_STATUS and RADIO excepted; a key and a time stamp of zeros end that. On a
  link that counts as USB it hears unsigned and wrongly signed frames too. The key survives a reboot.

  Its clock for that is no clock: GPS sets it once, then it goes on by one with each frame that it sends, and to the time
  stamp of each right frame that it hears. It is stored every 30 s, and begins a minute later than stored after a reboot.

  PX4 (1.18) is like it, but takes unsigned heartbeats from everybody.
  """

  alias MavCodec.Frame
  alias MavCodec.Messages.SetupSigning

  # Message ids that need no signature (S7).
  @unsigned %{ardupilot: [109, 166], px4: [0, 109]}

  @store_us 30_000_000
  @after_boot 6_000_000

  @enforce_keys [:secure]
  defstruct [:secure, :state, :key, firmware: :ardupilot, stored: 0, stored_at: 0]

  @type t :: %__MODULE__{
          secure: boolean,
          state: MavCodec.Signing.t() | nil,
          key: binary | nil,
          firmware: :ardupilot | :px4,
          stored: non_neg_integer,
          stored_at: integer
        }

  @doc "With a key from the start, or none, and with a clock that begins at a time stamp (nil: GPS time); `secure` as USB is."
  @spec new(binary | nil, boolean, :ardupilot | :px4, MavCodec.Signing.timestamp() | nil) :: t
  def new(key, secure, firmware \\ :ardupilot, at \\ nil) do
    signing = %__MODULE__{secure: secure, firmware: firmware}
    if key, do: with_key(signing, key, at || gps()), else: signing
  end

  defp gps, do: MavCodec.Signing.timestamp(MavCodec.Signing.new(<<0::256>>))

  defp with_key(signing, key, at) do
    options = [stored: at, accept_unsigned: Map.fetch!(@unsigned, signing.firmware)]
    options = if signing.firmware == :ardupilot, do: [clock: fn -> 0 end] ++ options, else: options
    %{signing | state: MavCodec.Signing.new(key, options), key: key, stored: at}
  end

  @doc "It is `us` of its own time: the clock is stored when that is due."
  @spec tick(t, integer) :: t
  def tick(%{state: state, stored_at: at} = signing, us) when state != nil and us - at >= @store_us,
    do: %{signing | stored: MavCodec.Signing.timestamp(state), stored_at: us}

  def tick(signing, _us), do: signing

  @doc "It was restarted: the clock begins with what was stored, and nobody is remembered."
  @spec rebooted(t) :: t
  def rebooted(%{state: nil} = signing), do: signing

  def rebooted(%{key: key, stored: stored} = signing),
    do: with_key(%{signing | stored_at: 0}, key, stored + @after_boot)

  @doc "The frame of a message as it goes out."
  @spec sign(t, binary, struct, module) :: {binary, t}
  def sign(%{state: nil} = signing, bytes, _message, _dialect), do: {bytes, signing}
  def sign(signing, <<0xFE, _::binary>> = bytes, _message, _dialect), do: {bytes, signing}

  def sign(signing, bytes, %module{}, dialect) do
    {_id, extra, _base, _extended} = dialect.layout(module)
    {bytes, state} = MavCodec.Signing.sign(signing.state, bytes, extra)
    {bytes, %{signing | state: state}}
  end

  @doc "Whether a frame is heard."
  @spec check(t, Frame.t()) :: {:ok | :refused, t}
  def check(%{state: nil} = signing, _frame), do: {:ok, signing}

  def check(signing, frame) do
    case MavCodec.Signing.check(signing.state, frame) do
      {{:rejected, _why}, state} -> {if(signing.secure, do: :ok, else: :refused), %{signing | state: state}}
      {_right, state} -> {:ok, %{signing | state: state}}
    end
  end

  @doc "SETUP_SIGNING came, for whomever."
  @spec setup(t, SetupSigning.t(), map) :: t
  def setup(%{firmware: :ardupilot} = signing, _setup, %{armed: true}), do: signing

  def setup(signing, %{target_system: system} = setup, %{system: system}) do
    case setup do
      %{secret_key: <<0::256>>, initial_timestamp: 0} -> %{signing | state: nil}
      %{secret_key: key, initial_timestamp: at} -> with_key(signing, key, at)
    end
  end

  def setup(signing, _for_another, _vehicle), do: signing
end
