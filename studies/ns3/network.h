// Stations, traffic and measurements that the reference programs share. There is no IP stack: packets are
// given to the Wi-Fi devices with the length that UDP over IPv4 would have, so that frames have the same
// length as in the emulator. All times are simulated unless a name says otherwise.
#pragma once

#include "ns3/core-module.h"
#include "ns3/mobility-module.h"
#include "ns3/network-module.h"
#include "ns3/propagation-module.h"
#include "ns3/wifi-module.h"

#include <sys/resource.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <iomanip>
#include <iostream>
#include <string>
#include <vector>

namespace reference
{

using namespace ns3;

constexpr uint32_t UDP_IP_BYTES = 8 + 20; // headers of UDP and IPv4; the device adds 8 B of LLC/SNAP
constexpr uint16_t IPV4_ETHER_TYPE = 0x0800;
constexpr double NOISE_FIGURE_DB = 7.0;

// Settings of one Wi-Fi network, all of whose stations are equal.
struct WifiSettings
{
    WifiStandard standard = WIFI_STANDARD_80211a;
    bool qos = false;                          // EDCA, best effort; false: DCF without QoS
    uint16_t widthMhz = 20;                    // in the 5 GHz band
    std::string dataMode = "OfdmRate6Mbps";    // unicast data frames
    std::string controlMode = "OfdmRate6Mbps"; // RTS; ns-3 chooses the modes of responses itself
    std::string groupMode = "OfdmRate6Mbps";   // group-addressed frames
    uint8_t streams = 1;                       // antennas and spatial streams
    uint16_t guardIntervalNs = 800;            // HE only; HT and VHT have 800 ns
    uint32_t rtsThresholdBytes = 4692480;      // PSDU length above which RTS is sent; default: never
    uint32_t ampduBytes = 0;                   // greatest A-MPDU of best effort; 0: no A-MPDU
    uint32_t amsduBytes = 0;                   // greatest A-MSDU of best effort; 0: no A-MSDU
    uint16_t blockAckFrames = 64;              // HE only: frames of the Block Ack window, 64 to 256
    double txPowerDbm = 16.0;
    double slotUs = 9.0;
};

// Sets the defaults of ns-3 and installs one ad-hoc Wi-Fi device on each node. Positions and path loss are
// those of `mobility` and `loss`. Transmit queues are long and frames do not expire in them.
inline NetDeviceContainer
InstallWifi(const WifiSettings& settings,
            const NodeContainer& nodes,
            Ptr<PropagationLossModel> loss,
            Ptr<PositionAllocator> positions)
{
    Config::SetDefault("ns3::WifiMacQueue::MaxSize", QueueSizeValue(QueueSize("4000p")));
    Config::SetDefault("ns3::WifiMacQueue::MaxDelay", TimeValue(Seconds(3600)));
    Config::SetDefault("ns3::WifiRemoteStationManager::RtsCtsThreshold",
                       UintegerValue(settings.rtsThresholdBytes));
    // seven transmissions in all, with and without RTS: MaxSlrc of 4 is only for frames above the threshold
    Config::SetDefault("ns3::WifiRemoteStationManager::MaxSsrc", UintegerValue(7));
    Config::SetDefault("ns3::WifiRemoteStationManager::MaxSlrc", UintegerValue(7));
    Config::SetDefault("ns3::HeConfiguration::GuardInterval",
                       TimeValue(NanoSeconds(settings.guardIntervalNs)));
    Config::SetDefault("ns3::HeConfiguration::MpduBufferSize", UintegerValue(settings.blockAckFrames));

    MobilityHelper mobility;
    mobility.SetPositionAllocator(positions);
    mobility.SetMobilityModel("ns3::ConstantPositionMobilityModel");
    mobility.Install(nodes);

    auto channel = CreateObject<YansWifiChannel>();
    channel->SetPropagationLossModel(loss);
    channel->SetPropagationDelayModel(CreateObject<ConstantSpeedPropagationDelayModel>());
    YansWifiPhyHelper phy;
    phy.SetChannel(channel);
    phy.Set("ChannelSettings",
            StringValue("{0, " + std::to_string(settings.widthMhz) + ", BAND_5GHZ, 0}"));
    phy.Set("TxPowerStart", DoubleValue(settings.txPowerDbm));
    phy.Set("TxPowerEnd", DoubleValue(settings.txPowerDbm));
    phy.Set("RxNoiseFigure", DoubleValue(NOISE_FIGURE_DB));
    phy.Set("Antennas", UintegerValue(settings.streams));
    phy.Set("MaxSupportedTxSpatialStreams", UintegerValue(settings.streams));
    phy.Set("MaxSupportedRxSpatialStreams", UintegerValue(settings.streams));

    WifiHelper wifi;
    wifi.SetStandard(settings.standard);
    wifi.SetRemoteStationManager("ns3::ConstantRateWifiManager",
                                 "DataMode",
                                 StringValue(settings.dataMode),
                                 "ControlMode",
                                 StringValue(settings.controlMode),
                                 "NonUnicastMode",
                                 StringValue(settings.groupMode));
    WifiMacHelper mac;
    mac.SetType("ns3::AdhocWifiMac",
                "QosSupported",
                BooleanValue(settings.qos),
                "BE_MaxAmpduSize",
                UintegerValue(settings.ampduBytes),
                "BE_MaxAmsduSize",
                UintegerValue(settings.amsduBytes),
                "VO_MaxAmpduSize",
                UintegerValue(0));
    NetDeviceContainer devices = wifi.Install(phy, mac, nodes);
    for (uint32_t i = 0; i < devices.GetN(); i++)
    {
        auto device = DynamicCast<WifiNetDevice>(devices.Get(i));
        device->GetPhy()->SetSlot(NanoSeconds(std::llround(1e3 * settings.slotUs)));
        if (settings.qos)
        {
            // one exchange in a TXOP: with a limit 3.37 sends a CF-End after the last exchange
            device->GetMac()->GetQosTxop(AC_VO)->SetTxopLimit(Time());
        }
    }
    // random numbers depend on RngSeed and RngRun alone
    wifi.AssignStreams(devices, 1000);
    return devices;
}

inline Ptr<WifiMac>
MacOf(Ptr<NetDevice> device)
{
    return DynamicCast<WifiNetDevice>(device)->GetMac();
}

// Keeps `backlog` packets in the queue of a device: each packet that is acknowledged or dropped is replaced
// by a new one. Must exist until the end of the simulation.
class SaturatedSender
{
  public:
    SaturatedSender(Ptr<NetDevice> device, const Address& to, uint32_t payloadBytes, uint32_t backlog)
        : m_device(device),
          m_to(to),
          m_packetBytes(payloadBytes + UDP_IP_BYTES)
    {
        auto mac = MacOf(device);
        mac->TraceConnectWithoutContext("AckedMpdu", MakeCallback(&SaturatedSender::Acked, this));
        mac->TraceConnectWithoutContext("DroppedMpdu", MakeCallback(&SaturatedSender::Dropped, this));
        mac->TraceConnectWithoutContext("MpduResponseTimeout",
                                        MakeCallback(&SaturatedSender::TimedOut, this));
        Simulator::Schedule(Seconds(0), &SaturatedSender::Send, this, backlog);
    }

    // Frames that ended in acknowledgement, at the retry limit, and transmissions without a response.
    uint64_t acked = 0;
    uint64_t dropped = 0;
    uint64_t timedOut = 0;

    void Reset()
    {
        acked = dropped = timedOut = 0;
    }

  private:
    void Send(uint32_t count)
    {
        for (uint32_t i = 0; i < count; i++)
        {
            m_device->Send(Create<Packet>(m_packetBytes), m_to, IPV4_ETHER_TYPE);
        }
    }

    void Replace(Ptr<const WifiMpdu> mpdu)
    {
        // an A-MSDU holds several packets; management frames are not ours
        if (!mpdu->GetHeader().IsData())
        {
            return;
        }
        const bool several = mpdu->GetHeader().IsQosData() && mpdu->GetHeader().IsQosAmsdu();
        Send(several ? std::distance(mpdu->begin(), mpdu->end()) : 1);
    }

    void Acked(Ptr<const WifiMpdu> mpdu)
    {
        acked += mpdu->GetHeader().IsData();
        Replace(mpdu);
    }

    void Dropped(WifiMacDropReason, Ptr<const WifiMpdu> mpdu)
    {
        dropped += mpdu->GetHeader().IsData();
        Replace(mpdu);
    }

    void TimedOut(uint8_t, Ptr<const WifiMpdu> mpdu, const WifiTxVector&)
    {
        timedOut += mpdu->GetHeader().IsData();
    }

    Ptr<NetDevice> m_device;
    Address m_to;
    uint32_t m_packetBytes;
};

// Counts packets that a device passes up, by their payload; `payloadMbps` counts those of one length.
class Sink
{
  public:
    explicit Sink(Ptr<NetDevice> device)
    {
        device->SetReceiveCallback(MakeCallback(&Sink::Receive, this));
    }

    void Reset()
    {
        m_packets.clear();
        m_total = 0;
    }

    uint64_t Packets(uint32_t payloadBytes) const
    {
        const uint32_t bytes = payloadBytes + UDP_IP_BYTES;
        return bytes < m_packets.size() ? m_packets[bytes] : 0;
    }

    uint64_t Packets() const
    {
        return m_total;
    }

    double PayloadMbps(uint32_t payloadBytes, double seconds) const
    {
        return Packets(payloadBytes) * 8e-6 * payloadBytes / seconds;
    }

  private:
    bool Receive(Ptr<NetDevice>, Ptr<const Packet> packet, uint16_t, const Address&)
    {
        const uint32_t bytes = packet->GetSize();
        if (bytes >= m_packets.size())
        {
            m_packets.resize(bytes + 1);
        }
        m_packets[bytes]++;
        m_total++;
        return true;
    }

    std::vector<uint64_t> m_packets; // by bytes
    uint64_t m_total = 0;
};

// Prints every transmission of the devices on standard error: time (us), station, frame type of the first
// MPDU, MPDUs, bytes, mode, duration (us). For inspection of short runs.
inline void
PrintTransmissions(const NetDeviceContainer& devices)
{
    std::cerr << std::fixed << std::setprecision(3);
    for (uint32_t i = 0; i < devices.GetN(); i++)
    {
        auto phy = DynamicCast<WifiNetDevice>(devices.Get(i))->GetPhy();
        std::function<void(WifiConstPsduMap, WifiTxVector, double)> print =
            [i, phy](WifiConstPsduMap psdus, WifiTxVector vector, double) {
                const auto psdu = psdus.begin()->second;
                std::cerr << Simulator::Now().GetNanoSeconds() * 1e-3 << " " << i << " "
                          << psdu->GetHeader(0).GetTypeString() << " " << psdu->GetNMpdus() << " "
                          << psdu->GetSize() << " " << vector.GetMode() << " "
                          << WifiPhy::CalculateTxDuration(psdu, vector, phy->GetPhyBand())
                                     .GetNanoSeconds() *
                                 1e-3
                          << "\n";
            };
        phy->TraceConnectWithoutContext("PhyTxPsduBegin",
                                        Callback<void, WifiConstPsduMap, WifiTxVector, double>(print));
    }
}

// Processor time of this process in seconds, user and system.
inline double
CpuSeconds()
{
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto seconds = [](const timeval& time) { return time.tv_sec + 1e-6 * time.tv_usec; };
    return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

// Positions on a circle around the origin.
inline Ptr<ListPositionAllocator>
Circle(uint32_t stations, double radiusM)
{
    auto positions = CreateObject<ListPositionAllocator>();
    for (uint32_t i = 0; i < stations; i++)
    {
        const double angle = 2.0 * M_PI * i / stations;
        positions->Add(Vector(radiusM * std::cos(angle), radiusM * std::sin(angle), 10.0));
    }
    return positions;
}

// The same received power at every station, whatever the distance.
inline Ptr<PropagationLossModel>
EqualPower(double powerDbm)
{
    auto loss = CreateObject<FixedRssLossModel>();
    loss->SetRss(powerDbm);
    return loss;
}

} // namespace reference
