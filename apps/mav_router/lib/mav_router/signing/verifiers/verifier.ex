defmodule MavRouter.Signing.Verifiers.Verifier do
  @moduledoc """
  The verdict on a frame by a scope's policy: pure, around `MavCodec.Signing`.

  | verdict | meaning |
  |---|---|
  | `:verified` | the signature is right |
  | `:exempt` | it needs none: RADIO_STATUS of a radio (S7), or a message that the configuration lists, from a component that does not sign |
  | `:secure` | unsigned, but it came by a link that is marked secure |
  | `:unsigned` | unsigned, which the policy accepts (S11) |
  | `:unchecked` | the policy is off |
  | `{:rejected, reason}` | `:unsigned`, `:wrong_signature`, `:replayed`, `:stale`, `:too_many_streams`, `:no_key` |

  A wrong signature is refused under every policy but `:off`, on a secure link too.
  """

  alias MavRouter.Signing.Scope
  alias MavCodec.Frame.Splitter
  alias MavCodec.Frame
  alias MavCodec.Signing

  @typedoc """
  How far a link is trusted: `:radio` not at all, `:secure` it is a cable that the operator vouches for, `:recording` it is a file.
  """
  @type trust :: :radio | :secure | :recording

  @type verdict :: :verified | :exempt | :secure | :unsigned | :unchecked | {:rejected, atom}

  @doc "The verdict on one frame. `signing` is nil when the scope's key could not be read."
  @spec check(Scope.t(), Signing.t() | nil, Frame.t(), trust) :: {verdict, Signing.t() | nil}
  def check(%Scope{policy: :off}, signing, _frame, _trust), do: {:unchecked, signing}

  def check(scope, signing, %Frame{signature: nil} = frame, trust),
    do: {unsigned(scope, signing, frame, trust), signing}

  def check(_scope, nil, _frame, _trust), do: {{:rejected, :no_key}, nil}

  def check(_scope, signing, frame, _trust) do
    case Signing.check(signing, frame) do
      {:signed, signing} -> {:verified, signing}
      {rejected, signing} -> {rejected, signing}
    end
  end

  # A component that can sign must, and an autopilot is not a radio. Otherwise anybody could attract the vehicle's frames by a
  # RADIO_STATUS in its name.
  defp unsigned(scope, signing, frame, trust) do
    cond do
      frame.id in scope.allow and frame.component != 1 and not signs?(signing, frame) -> :exempt
      trust == :secure -> :secure
      scope.policy == :accept_unsigned -> :unsigned
      true -> {:rejected, :unsigned}
    end
  end

  defp signs?(nil, _frame), do: false

  defp signs?(signing, %Frame{system: system, component: component}),
    do: Enum.any?(Signing.streams(signing), &match?({{_link_id, ^system, ^component}, _last}, &1))

  @doc """
  Signs the unsigned frames of MAVLink 2 in `bytes` that come from `own` (`{system, component}`, or `:any`); everything else stays as
  it is (S10). Gives the bytes, how many frames were signed, and how many from `own` could not be.
  """
  @spec sign(Signing.t(), binary, {non_neg_integer, 0..255} | :any) ::
          {iodata, signed :: non_neg_integer, unsigned :: non_neg_integer, Signing.t()}
  def sign(signing, bytes, own) do
    {frames, rest} = Splitter.frames(bytes)

    {out, {signed, unsigned, signing}} =
      Enum.map_reduce(frames, {0, 0, signing}, fn frame, {signed, unsigned, signing} ->
        case one(Splitter.checked(frame), own, signing) do
          {:signed, bytes, signing} -> {bytes, {signed + 1, unsigned, signing}}
          :unsigned -> {frame.bytes, {signed, unsigned + 1, signing}}
          :foreign -> {frame.bytes, {signed, unsigned, signing}}
        end
      end)

    {[out, rest], signed, unsigned, signing}
  end

  defp one(%Frame{signature: nil} = frame, :any, signing), do: one(frame, signing)

  defp one(
         %Frame{system: system, component: component, signature: nil} = frame,
         {system, component},
         signing
       ),
       do: one(frame, signing)

  defp one(_frame, _own, _signing), do: :foreign

  defp one(frame, signing) do
    case frame do
      %Frame{version: 2, crc_extra: extra} when extra != nil ->
        {bytes, signing} = Signing.sign(signing, frame.bytes, extra)
        {:signed, bytes, signing}

      _version_1_or_unknown ->
        :unsigned
    end
  end
end
